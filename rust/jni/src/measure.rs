//! A measurement as Java asks for it: calibration, network and stop sign together.

use crate::guard::Failure;
use crate::handles::Handles;
use boxline::{BoxReport, Calibration, FaceOutcome, Frame, Settings, StageTimes};
use std::num::NonZeroUsize;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Signs that say "stop"; Java sets one from another thread.
pub(crate) static STOPS: Handles<AtomicBool> = Handles::new();

/// The sign of a handle; 0 stands for none.
pub(crate) fn stop_sign(handle: i64) -> Result<Option<Arc<AtomicBool>>, Failure> {
    if handle == 0 { Ok(None) } else { Ok(Some(STOPS.get(handle)?)) }
}

pub(crate) fn measure_box(
    frames: [&Frame; 2],
    calibration: &Calibration,
    stop: Option<&AtomicBool>,
) -> Result<BoxReport, Failure> {
    let network = network::get()?;
    let settings = Settings { network: network.as_ref_dyn(), cancelled: stop, ..Settings::default() };
    Ok(boxline::measure_box(frames[0], frames[1], calibration, &settings, &mut StageTimes::new())?)
}

pub(crate) fn measure_face(
    frame: &Frame,
    calibration: &Calibration,
    stop: Option<&AtomicBool>,
) -> Result<FaceOutcome, Failure> {
    let network = network::get()?;
    let settings = Settings { network: network.as_ref_dyn(), cancelled: stop, ..Settings::default() };
    Ok(boxline::measure_face(frame, calibration, &settings, &mut StageTimes::new())?)
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

    /// Once per process: it holds 60 MB, and a process can load one ONNX Runtime only.
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
