//! Every function that Java can call. Each does one thing: it calls `guard`.
//!
//! | Happens | Java sees |
//! |---|---|
//! | the calibration is broken, of another head, or for frames of another size; the network does not load | `dev.boxline.ScannerConfigException` |
//! | a frame is not a whole JPEG | `dev.boxline.InvalidFrameException` |
//! | the head is gone, busy, silent, ... | `dev.boxline.DeviceException` with the name of a `DeviceCause` |
//! | a handle is closed or never was | `IllegalStateException` |
//! | an argument is null, a buffer is not direct | `NullPointerException`, `IllegalArgumentException` |
//! | the stop sign was set | `java.util.concurrent.CancellationException` |
//! | a panic | `dev.boxline.NativeBugException`; the process lives |
//!
//! All functions may be called from any thread. A view that cannot be measured is a result, not an exception. Handles are
//! never 0; closing one twice does nothing, and calls that are running finish. Where a function takes a `stop`, it is a
//! handle of `newStop`, or 0 for none.
#![allow(unsafe_code)] // exporting a symbol counts as unsafe: two libraries could export the same one

use crate::buffer::{bytes_of_array, bytes_of_buffer};
use crate::guard::{Failure, guard};
use crate::handles::Handles;
use crate::logging;
use crate::measure::{self, Picture, STOPS, load_network, network_name, stop_sign};
use crate::recording::read_pair;
use crate::session::{FRAMES, HEADS, Head, check_serial};
use boxline::Calibration;
use boxline_proto::json::{parse_calibration, report_json};
use boxline_proto::message::decode_report;
use jni::objects::{JByteArray, JByteBuffer, JClass, JLongArray, JObject, JString};
use jni::sys::{jboolean, jint, jlong};
use jni::{EnvUnowned, jni_mangle};
use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

static CALIBRATIONS: Handles<Calibration> = Handles::new();
/// More threads than this wait for each other; thousands never end.
const MOST_THREADS: usize = 64;

/// `static native void start(int logLevel, int threads)`: starts the log (0 off to 4 details) and loads the network with
/// so many threads, at most 64 (0: as the machine has, at most four). The first call counts, later ones change the log's level only.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn start<'local>(
    env: EnvUnowned<'local>,
    _class: JClass<'local>,
    log_level: jint,
    threads: jint,
) {
    guard(env, |_| {
        let threads = usize::try_from(threads)
            .ok()
            .filter(|count| *count <= MOST_THREADS)
            .ok_or_else(|| Failure::Argument(format!("threads {threads}: 0 to {MOST_THREADS} are allowed")))
            .map(NonZeroUsize::new)?;
        logging::start(log_level);
        load_network(threads)
    })
}

/// `static native String version()`: version, processor and what runs the network, for reports of bugs.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn version<'local>(env: EnvUnowned<'local>, _class: JClass<'local>) -> JString<'local> {
    guard(env, |env| {
        let (version, system) = (env!("CARGO_PKG_VERSION"), std::env::consts::OS);
        let text =
            format!("boxline {version}, {system} {}, network: {}", std::env::consts::ARCH, network_name()?);
        Ok(env.new_string(text)?)
    })
}

/// `static native void log(int level, String text)`: writes to the same log as this library.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn log<'local>(
    env: EnvUnowned<'local>,
    _class: JClass<'local>,
    level: jint,
    text: JString<'local>,
) {
    guard(env, |env| {
        if text.is_null() {
            return Err(Failure::Null("text"));
        }
        let text = text.try_to_string(env)?;
        match level {
            ..=1 => log::error!("{text}"),
            2 => log::warn!("{text}"),
            3 => log::info!("{text}"),
            _ => log::debug!("{text}"),
        }
        Ok(())
    })
}

/// `static native long openCalibration(byte[] json)`: reads a `calibration.json`.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn open_calibration<'local>(
    env: EnvUnowned<'local>,
    _class: JClass<'local>,
    json: JByteArray<'local>,
) -> jlong {
    guard(env, |env| {
        let json = bytes_of_array(env, &json, "json")?;
        Ok(CALIBRATIONS.open(parse_calibration(&json, "calibration")?))
    })
}

/// `static native long[] openRecording(String folder)`: the calibration and the first two lit frames of a recording, each to
/// be closed.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn open_recording<'local>(
    env: EnvUnowned<'local>,
    _class: JClass<'local>,
    folder: JString<'local>,
) -> JLongArray<'local> {
    guard(env, |env| {
        if folder.is_null() {
            return Err(Failure::Null("folder"));
        }
        let folder = folder.try_to_string(env)?;
        let (calibration, [a, b]) = read_pair(Path::new(&folder))?;
        let handles = env.new_long_array(3)?;
        handles.set_region(env, 0, &[CALIBRATIONS.open(calibration), FRAMES.open(a), FRAMES.open(b)])?;
        Ok(handles)
    })
}

/// `static native boolean hasCovariance(long calibration)`: whether it says how sure it is. If not, sigmas lack its part.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn has_covariance<'local>(
    env: EnvUnowned<'local>,
    _class: JClass<'local>,
    calibration: jlong,
) -> jboolean {
    guard(env, |_| Ok(CALIBRATIONS.get(calibration)?.covariance().is_some()))
}

/// `static native void closeCalibration(long handle)`.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn close_calibration<'local>(
    env: EnvUnowned<'local>,
    _class: JClass<'local>,
    handle: jlong,
) {
    guard(env, |_| Ok(CALIBRATIONS.close(handle)?));
}

/// `static native long newStop()`: a sign that ends calls which were given it.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn new_stop<'local>(env: EnvUnowned<'local>, _class: JClass<'local>) -> jlong {
    guard(env, |_| Ok(STOPS.open(AtomicBool::new(false))))
}

/// `static native void setStop(long stop)`: such calls end within some hundred milliseconds, with a `CancellationException`.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn set_stop<'local>(env: EnvUnowned<'local>, _class: JClass<'local>, stop: jlong) {
    guard(env, |_| {
        STOPS.get(stop)?.store(true, Ordering::SeqCst);
        Ok(())
    })
}

/// `static native void closeStop(long stop)`.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn close_stop<'local>(env: EnvUnowned<'local>, _class: JClass<'local>, stop: jlong) {
    guard(env, |_| Ok(STOPS.close(stop)?));
}

/// `static native byte[] measureBox(long calibration, ByteBuffer frameA, ByteBuffer frameB, ByteBuffer frameC, ByteBuffer offA, ByteBuffer
/// offB, ByteBuffer offC, long stop)`: measures a box from two frames, or from three unless `frameC` is null; of each the same view with
/// the lasers off, or null. Each buffer is direct and holds one JPEG from position to limit; all stay unchanged. Gives the bytes of a `boxline.v1.BoxReport` whose faces are called `a`, `b` and `c`.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn measure_box<'local>(
    env: EnvUnowned<'local>,
    _class: JClass<'local>,
    calibration: jlong,
    frame_a: JByteBuffer<'local>,
    frame_b: JByteBuffer<'local>,
    frame_c: JByteBuffer<'local>,
    off_a: JByteBuffer<'local>,
    off_b: JByteBuffer<'local>,
    off_c: JByteBuffer<'local>,
    stop: jlong,
) -> JByteArray<'local> {
    guard(env, |env| {
        let calibration = CALIBRATIONS.get(calibration)?;
        let stop = stop_sign(stop)?;
        let faces = [
            (&frame_a, "frameA", &off_a, "offA"),
            (&frame_b, "frameB", &off_b, "offB"),
            (&frame_c, "frameC", &off_c, "offC"),
        ];
        let given = if frame_c.is_null() { 2 } else { 3 };
        let mut bytes = Vec::new();
        for (frame, name, off, off_name) in faces.into_iter().take(given) {
            let jpeg = bytes_of_buffer(env, frame, name)?;
            let off = if off.is_null() { None } else { Some(bytes_of_buffer(env, off, off_name)?) };
            bytes.push((jpeg, off));
        }
        let pictures: Vec<Picture<'_>> =
            bytes.iter().map(|(jpeg, off)| Picture { jpeg, off: off.as_deref() }).collect();
        Ok(env.byte_array_from_slice(&measure::faces(&pictures, &calibration, stop.as_deref())?)?)
    })
}

/// `static native byte[] viewFrame(long calibration, ByteBuffer frame, long stop)`: whether a face could be measured in this
/// frame. Gives the bytes of a `boxline.v1.LiveView`.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn view_frame<'local>(
    env: EnvUnowned<'local>,
    _class: JClass<'local>,
    calibration: jlong,
    frame: JByteBuffer<'local>,
    stop: jlong,
) -> JByteArray<'local> {
    guard(env, |env| {
        let calibration = CALIBRATIONS.get(calibration)?;
        let stop = stop_sign(stop)?;
        let jpeg = bytes_of_buffer(env, &frame, "frame")?;
        Ok(env.byte_array_from_slice(&measure::view(
            &Picture { jpeg: &jpeg, off: None },
            &calibration,
            stop.as_deref(),
        )?)?)
    })
}

/// `static native String reportJson(byte[] report)`: a report as `boxline measure --json` prints it.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn report_json_text<'local>(
    env: EnvUnowned<'local>,
    _class: JClass<'local>,
    report: JByteArray<'local>,
) -> JString<'local> {
    guard(env, |env| {
        let decoded = decode_report(&bytes_of_array(env, &report, "report")?)?;
        let ids: Vec<&str> = decoded.frame_ids.iter().map(String::as_str).collect();
        Ok(env.new_string(report_json(&decoded.report, &ids).to_string())?)
    })
}

/// `static native long openHead(int fd)`: opens the head behind the descriptor of a `UsbDeviceConnection`. It is
/// duplicated; close the head, then the connection.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn open_head<'local>(env: EnvUnowned<'local>, _class: JClass<'local>, fd: jint) -> jlong {
    guard(env, |_| Ok(HEADS.open(Head::open(fd)?)))
}

/// `static native void closeHead(long head)`: lasers off, stream off, interfaces let go; takes at most some seconds.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn close_head<'local>(env: EnvUnowned<'local>, _class: JClass<'local>, head: jlong) {
    guard(env, |_| Ok(HEADS.close(head)?));
}

/// `static native String headSerial(long head)`.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn head_serial<'local>(
    env: EnvUnowned<'local>,
    _class: JClass<'local>,
    head: jlong,
) -> JString<'local> {
    guard(env, |env| {
        let head = HEADS.get(head)?;
        Ok(env.new_string(&head.serial)?)
    })
}

/// `static native long openHeadCalibration(long head)`: the calibration stored in the head; close it as any other.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn open_head_calibration<'local>(
    env: EnvUnowned<'local>,
    _class: JClass<'local>,
    head: jlong,
) -> jlong {
    guard(env, |_| {
        let head = HEADS.get(head)?;
        Ok(CALIBRATIONS.open(head.calibration()?))
    })
}

/// `static native void startStream(long head)`: lasers on, stream on.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn start_stream<'local>(env: EnvUnowned<'local>, _class: JClass<'local>, head: jlong) {
    guard(env, |_| HEADS.get(head)?.start())
}

/// `static native void stopStream(long head)`: lasers off, stream off; takes at most some seconds.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn stop_stream<'local>(env: EnvUnowned<'local>, _class: JClass<'local>, head: jlong) {
    guard(env, |_| {
        HEADS.get(head)?.stop();
        Ok(())
    })
}

/// `static native byte[] liveView(long head, long calibration, long after, long stop)`: waits for a lit frame later than
/// number `after` and looks whether its face can be measured, or where that of an earlier frame is now. Gives the bytes of a `boxline.v1.LiveView`.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn live_view<'local>(
    env: EnvUnowned<'local>,
    _class: JClass<'local>,
    head: jlong,
    calibration: jlong,
    after: jlong,
    stop: jlong,
) -> JByteArray<'local> {
    guard(env, |env| {
        let head = HEADS.get(head)?;
        let calibration = CALIBRATIONS.get(calibration)?;
        head.check_calibration(&calibration)?;
        let stop = stop_sign(stop)?;
        let after = u64::try_from(after).map_err(|e| Failure::Argument(format!("after {after}: {e}")))?;
        let (number, frame) = head.lit_frame(after, stop.as_deref())?;
        let stop = stop.as_deref();
        let seen = measure::live_view(&head, number, &frame.jpeg, &calibration, stop)?;
        Ok(env.byte_array_from_slice(&seen)?)
    })
}

/// `static native long captureFrame(long head, long stop)`: the next frame that all lasers lit and one with them off right
/// after it, kept until `closeFrame`.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn capture_frame<'local>(
    env: EnvUnowned<'local>,
    _class: JClass<'local>,
    head: jlong,
    stop: jlong,
) -> jlong {
    guard(env, |_| {
        let head = HEADS.get(head)?;
        let stop = stop_sign(stop)?;
        Ok(FRAMES.open(head.capture(stop.as_deref())?))
    })
}

/// `static native void closeFrame(long frame)`.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn close_frame<'local>(env: EnvUnowned<'local>, _class: JClass<'local>, frame: jlong) {
    guard(env, |_| Ok(FRAMES.close(frame)?));
}

/// `static native byte[] frameJpeg(long frame)`: the frame as the head sent it, for a record or an image file.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn frame_jpeg<'local>(
    env: EnvUnowned<'local>,
    _class: JClass<'local>,
    frame: jlong,
) -> JByteArray<'local> {
    guard(env, |env| {
        let frame = FRAMES.get(frame)?;
        Ok(env.byte_array_from_slice(&frame.jpeg)?)
    })
}

/// `static native byte[] viewCaptured(long calibration, long frame, long stop)`: as `viewFrame`, for a captured frame.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn view_captured<'local>(
    env: EnvUnowned<'local>,
    _class: JClass<'local>,
    calibration: jlong,
    frame: jlong,
    stop: jlong,
) -> JByteArray<'local> {
    guard(env, |env| {
        let calibration = CALIBRATIONS.get(calibration)?;
        let frame = FRAMES.get(frame)?;
        check_serial(&frame.serial, &calibration)?;
        let stop = stop_sign(stop)?;
        let picture = Picture { jpeg: &frame.jpeg, off: frame.off.as_deref() };
        let view = measure::view(&picture, &calibration, stop.as_deref())?;
        Ok(env.byte_array_from_slice(&view)?)
    })
}

/// `static native byte[] measureFrames(long calibration, long[] frames, long stop)`: as `measureBox`, for two or three captured
/// frames.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn measure_frames<'local>(
    env: EnvUnowned<'local>,
    _class: JClass<'local>,
    calibration: jlong,
    frames: JLongArray<'local>,
    stop: jlong,
) -> JByteArray<'local> {
    guard(env, |env| {
        let calibration = CALIBRATIONS.get(calibration)?;
        let stop = stop_sign(stop)?;
        let mut handles = vec![0; frames.len(env)?];
        frames.get_region(env, 0, &mut handles)?;
        let frames: Vec<_> =
            handles.into_iter().map(|handle| FRAMES.get(handle)).collect::<Result<_, _>>()?;
        frames.iter().try_for_each(|frame| check_serial(&frame.serial, &calibration))?;
        let pictures: Vec<Picture<'_>> =
            frames.iter().map(|frame| Picture { jpeg: &frame.jpeg, off: frame.off.as_deref() }).collect();
        let report = measure::faces(&pictures, &calibration, stop.as_deref())?;
        Ok(env.byte_array_from_slice(&report)?)
    })
}

/// `static native boolean showPreview(long head, Object surface)`: draws every frame into an `android.view.Surface` until
/// null is given. False where there are no such surfaces, or if this one is gone.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn show_preview<'local>(
    env: EnvUnowned<'local>,
    _class: JClass<'local>,
    head: jlong,
    surface: JObject<'local>,
) -> jboolean {
    guard(env, |env| {
        let head = HEADS.get(head)?;
        #[cfg(target_os = "android")]
        {
            let window =
                (!surface.is_null()).then(|| crate::window::Window::of_surface(env, &surface)).flatten();
            let shown = window.is_some();
            head.set_window(window);
            Ok(shown)
        }
        #[cfg(not(target_os = "android"))]
        {
            let _unused = (env, head, surface);
            Ok(false)
        }
    })
}

/// Entry points of `dev.boxline.internal.NativeTesting`, which prove the guard from the Java side.
#[cfg(feature = "testing")]
pub mod testing {
    use super::{CALIBRATIONS, FRAMES, Failure, HEADS, STOPS, guard};
    use crate::buffer::{bytes_of_array, bytes_of_buffer};
    use boxline::{Error, ErrorKind};
    use jni::objects::{JByteArray, JByteBuffer, JClass, JString};
    use jni::sys::jint;
    use jni::{EnvUnowned, jni_mangle};

    /// `static native byte[] echo(byte[] bytes)`.
    #[jni_mangle("dev.boxline.internal.NativeTesting")]
    pub extern "system" fn echo<'local>(
        env: EnvUnowned<'local>,
        _class: JClass<'local>,
        bytes: JByteArray<'local>,
    ) -> JByteArray<'local> {
        guard(env, |env| {
            let bytes = bytes_of_array(env, &bytes, "bytes")?;
            Ok(env.byte_array_from_slice(&bytes)?)
        })
    }

    /// `static native byte[] echoBuffer(ByteBuffer buffer)`: what a frame's bytes are seen to be.
    #[jni_mangle("dev.boxline.internal.NativeTesting")]
    pub extern "system" fn echo_buffer<'local>(
        env: EnvUnowned<'local>,
        _class: JClass<'local>,
        buffer: JByteBuffer<'local>,
    ) -> JByteArray<'local> {
        guard(env, |env| {
            let bytes = bytes_of_buffer(env, &buffer, "buffer")?;
            Ok(env.byte_array_from_slice(&bytes)?)
        })
    }

    /// `static native void panicWith(String message)`: panics with a `String`, with a `&str` if `message` is empty, with
    /// something else if it is null.
    #[jni_mangle("dev.boxline.internal.NativeTesting")]
    pub extern "system" fn panic_with<'local>(
        env: EnvUnowned<'local>,
        _class: JClass<'local>,
        message: JString<'local>,
    ) {
        guard(env, |env| {
            if message.is_null() {
                std::panic::panic_any(7);
            }
            let message = message.try_to_string(env)?;
            if message.is_empty() {
                panic!("a fixed text");
            }
            panic!("{message}")
        })
    }

    /// `static native long failWith(int kind, String text)`: fails with an error of the kind in the order of `ErrorKind`.
    #[jni_mangle("dev.boxline.internal.NativeTesting")]
    pub extern "system" fn fail_with<'local>(
        env: EnvUnowned<'local>,
        _class: JClass<'local>,
        kind: jint,
        text: JString<'local>,
    ) -> i64 {
        guard(env, |env| {
            let kind = match kind {
                0 => ErrorKind::InvalidCalibration,
                1 => ErrorKind::CalibrationMismatch,
                2 => ErrorKind::InvalidFrame,
                3 => ErrorKind::InvalidFile,
                4 => ErrorKind::Io,
                5 => ErrorKind::ModelFile,
                6 => ErrorKind::NetworkRuntime,
                7 => ErrorKind::Cancelled,
                _ => return Err(Failure::Argument(format!("kind {kind} is not known"))),
            };
            Err(Error::new(kind, text.try_to_string(env)?).into())
        })
    }

    /// `static native int openHandles()`: how many calibrations, stop signs, heads and frames are open.
    #[jni_mangle("dev.boxline.internal.NativeTesting")]
    pub extern "system" fn open_handles<'local>(env: EnvUnowned<'local>, _class: JClass<'local>) -> jint {
        guard(env, |_| {
            let all = CALIBRATIONS.count() + STOPS.count() + HEADS.count() + FRAMES.count();
            jint::try_from(all).map_err(|e| Failure::Argument(e.to_string()))
        })
    }
}
