//! Draws previews into a surface of the screen. Android only.
#![allow(unsafe_code)] // a surface comes from Java as a raw reference

use crate::preview;
use jni::Env;
use jni::objects::JObject;
use ndk::hardware_buffer_format::HardwareBufferFormat;
use ndk::native_window::NativeWindow;

/// A surface that Java has handed over; it stays valid, shown or not, until this is dropped.
pub(crate) struct Window(NativeWindow);

impl Window {
    /// The window behind a `android.view.Surface`; none if the surface is gone already.
    pub fn of_surface(env: &Env<'_>, surface: &JObject<'_>) -> Option<Self> {
        // SAFETY: the environment is that of the running call and `surface` a live local reference of it, to an
        // android.view.Surface: `BoxMeter.showPreview` lets nothing else through. Both crates declare the same C types of jni.h.
        unsafe { NativeWindow::from_surface(env.get_raw().cast(), surface.as_raw().cast()) }.map(Self)
    }

    /// Draws a frame as large as it fits. A frame that cannot be drawn is skipped: the next one follows.
    pub fn draw(&self, jpeg: &[u8]) {
        if let Err(why) = self.try_draw(jpeg) {
            log::debug!("preview: {why}");
        }
    }

    fn try_draw(&self, jpeg: &[u8]) -> Result<(), String> {
        let side = |px: i32| usize::try_from(px).map_err(|e| e.to_string());
        let picture = preview::decode(jpeg, [side(self.0.width())?, side(self.0.height())?])
            .map_err(|e| e.to_string())?;
        let size = [picture.width_px, picture.height_px].map(|px| i32::try_from(px).unwrap_or(i32::MAX));
        // The system scales the buffer to the window.
        self.0
            .set_buffers_geometry(size[0], size[1], Some(HardwareBufferFormat::R8G8B8A8_UNORM))
            .map_err(|e| e.to_string())?;
        let mut buffer = self.0.lock(None).map_err(|e| e.to_string())?;
        let row_bytes = picture.width_px * 4;
        if buffer.width() < picture.width_px || buffer.height() < picture.height_px {
            return Err(format!("the window gave {} x {} px", buffer.width(), buffer.height()));
        }
        let lines = buffer.lines().ok_or("the window's format has no lines")?;
        for (line, row) in lines.zip(picture.rgba.chunks_exact(row_bytes)) {
            for (to, from) in line.iter_mut().zip(row) {
                to.write(*from);
            }
        }
        Ok(())
    }
}
