//! A measurement as Java asks for it: calibration, network and stop sign together.

use crate::guard::Failure;
use crate::handles::Handles;
use crate::session::Head;
use boxline::{Calibration, Frame, LiveFace, Settings, Workers, measure_box, measure_face};
use boxline_proto::message::{encode_live_view, encode_report};
use std::num::NonZeroUsize;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Signs that say "stop"; Java sets one from another thread.
pub(crate) static STOPS: Handles<AtomicBool> = Handles::new();

/// The sign of a handle; 0 stands for none.
pub(crate) fn stop_sign(handle: i64) -> Result<Option<Arc<AtomicBool>>, Failure> {
    if handle == 0 { Ok(None) } else { Ok(Some(STOPS.get(handle)?)) }
}

/// A thread for each frame of a box: phones have four fast cores.
struct FrameThreads;

impl Workers for FrameThreads {
    fn both(&self, first: &mut (dyn FnMut() + Send), second: &mut (dyn FnMut() + Send)) {
        std::thread::scope(|scope| {
            scope.spawn(second);
            first();
        });
    }
}

/// The JPEG of a face, and of the same view with the lasers off.
pub(crate) struct Picture<'a> {
    pub jpeg: &'a [u8],
    pub off: Option<&'a [u8]>,
}

/// Measures a box from two or three pictures. Gives the bytes of a `boxline.v1.BoxReport` whose faces are called `a`, `b` and `c`.
pub(crate) fn faces(
    pictures: &[Picture<'_>],
    calibration: &Calibration,
    stop: Option<&AtomicBool>,
) -> Result<Vec<u8>, Failure> {
    const NAMES: [&str; 3] = ["frameA", "frameB", "frameC"];
    let name = |i: usize| NAMES.get(i).copied().unwrap_or("a frame too many");
    let mut decoded: Vec<_> = pictures.iter().map(|_| None).collect();
    std::thread::scope(|scope| {
        for (i, (picture, frame)) in pictures.iter().zip(&mut decoded).enumerate() {
            scope.spawn(move || *frame = Some(decode(picture, name(i))));
        }
    });
    let frames: Vec<Frame> = decoded.into_iter().flatten().collect::<Result<_, _>>()?;
    let frames: Vec<&Frame> = frames.iter().collect();
    let network = network::get()?;
    let settings = Settings {
        network: network.as_ref_dyn(),
        workers: Some(&FrameThreads),
        cancelled: stop,
        ..Settings::default()
    };
    let report = measure_box(&frames, calibration, &settings)?;
    Ok(encode_report(&report, &["a", "b", "c"][..frames.len()]))
}

/// Whether a face could be measured in a frame. Gives the bytes of a `boxline.v1.LiveView`.
pub(crate) fn view(
    picture: &Picture<'_>,
    calibration: &Calibration,
    stop: Option<&AtomicBool>,
) -> Result<Vec<u8>, Failure> {
    let frame = decode(picture, "frame")?;
    let network = network::get()?;
    let settings = Settings { network: network.as_ref_dyn(), cancelled: stop, ..Settings::default() };
    let seen = LiveFace::Looked(measure_face(&frame, calibration, &settings)?);
    Ok(encode_live_view(&seen, false, 0))
}

/// What a head sees in its frame `number`: the same, or the face that an earlier frame showed.
pub(crate) fn live_view(
    head: &Head,
    number: u64,
    jpeg: &[u8],
    calibration: &Calibration,
    stop: Option<&AtomicBool>,
) -> Result<Vec<u8>, Failure> {
    let network = network::get()?;
    let settings = Settings { network: network.as_ref_dyn(), cancelled: stop, ..Settings::default() };
    let (seen, steady) = head.see(jpeg, calibration, &settings)?;
    Ok(encode_live_view(&seen, steady, number))
}

/// A picture with the lasers off that does not fit is left out, and told in the log: nothing is lost without it.
fn decode(picture: &Picture<'_>, name: &str) -> Result<Frame, Failure> {
    let decode = |jpeg, name: &str| Frame::from_jpeg(jpeg).map_err(|e| e.in_context(name));
    let mut frame = decode(picture.jpeg, name)?;
    if let Some(off) = picture.off {
        let off = decode(off, &format!("{name} with the lasers off"))?;
        match frame.add_ambient(&off) {
            Ok(left_px) => log::debug!("{name}: with the lasers off, {left_px:?} px beside it"),
            Err(e) => log::warn!("{name}: not used: {e}"),
        }
    }
    Ok(frame)
}

/// Loads the network if this library has one, so that a broken runtime is told when a scanner is opened, not when it is
/// used.
pub(crate) fn load_network(threads: Option<NonZeroUsize>) -> Result<(), Failure> {
    network::load(threads)
}

/// What runs the network, for people; `none` in a library without.
pub(crate) fn network_name() -> Result<&'static str, Failure> {
    network::get().map(|network| network.name())
}

#[cfg(feature = "network")]
mod network {
    use super::Failure;
    use boxline::Network;
    use boxline_edgenet::{EdgeNet, Options};
    use std::num::NonZeroUsize;
    use std::sync::{Arc, Mutex, PoisonError};

    /// Once per process: it takes time and memory, and a process can load one ONNX Runtime only.
    static NETWORK: Mutex<Option<Arc<EdgeNet>>> = Mutex::new(None);

    pub struct Loaded(Arc<EdgeNet>);

    impl Loaded {
        #[allow(clippy::unnecessary_wraps)] // the library without a network gives none
        pub fn as_ref_dyn(&self) -> Option<&dyn Network> {
            Some(&*self.0)
        }

        pub fn name(&self) -> &'static str {
            self.0.runtime_name()
        }
    }

    pub fn load(threads: Option<NonZeroUsize>) -> Result<(), Failure> {
        let mut network = NETWORK.lock().unwrap_or_else(PoisonError::into_inner);
        if network.is_none() {
            let mut options = Options::default();
            if let Some(threads) = threads {
                options.threads = threads;
            }
            let loaded = EdgeNet::embedded(&options)?;
            log::info!("network on {} with up to {} threads", loaded.runtime_name(), options.threads);
            *network = Some(Arc::new(loaded));
        }
        Ok(())
    }

    pub fn get() -> Result<Loaded, Failure> {
        load(None)?;
        let network = NETWORK.lock().unwrap_or_else(PoisonError::into_inner);
        Ok(Loaded(network.clone().expect("loaded above, and nothing takes it away")))
    }
}

#[cfg(not(feature = "network"))]
mod network {
    use super::Failure;
    use boxline::Network;
    use std::num::NonZeroUsize;

    pub struct Loaded;

    impl Loaded {
        pub fn as_ref_dyn(&self) -> Option<&dyn Network> {
            None
        }

        pub fn name(&self) -> &'static str {
            "none"
        }
    }

    #[allow(clippy::unnecessary_wraps)] // as with a network
    pub fn load(_threads: Option<NonZeroUsize>) -> Result<(), Failure> {
        Ok(())
    }

    #[allow(clippy::unnecessary_wraps)]
    pub fn get() -> Result<Loaded, Failure> {
        Ok(Loaded)
    }
}
