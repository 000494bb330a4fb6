//! The edge network: a frame in, the nine maps of [`boxline::network`] out; and the small network that looks at single lines.
//!
//! [`EdgeNet`] is what the product uses; `engine` below it runs any ONNX file of the same kind on ONNX Runtime
//! (`onnx_runtime`, where its library is found) or on tract (`tract`, always there); `downscale` makes the input.
//! Training, export and scores are Python, in `training/`.
#![forbid(unsafe_code)]

mod downscale;
mod engine;
mod onnx_runtime;
mod tract;

pub use engine::{Engine, Options, Runtime};

use boxline::network::{CHANNELS, FaceMaps, LineStrip, Network};
use boxline::{Error, ErrorKind, Frame};
use downscale::Downscaler;
use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

/// The weights that ship; `models/boxnet.md` says where they come from.
const EMBEDDED: &[u8] = include_bytes!("../models/boxnet.onnx");
/// The network of lines; `models/lines.md`.
const LINES: &[u8] = include_bytes!("../models/lines.onnx");

/// A loaded network. One frame at a time: calls from several threads wait for each other, so give each thread its own, or
/// one of them more [`Options::threads`].
pub struct EdgeNet {
    runtime_name: &'static str,
    state: Mutex<State>,
    lines: Mutex<Engine>,
}

/// What a run writes to.
struct State {
    engine: Engine,
    downscaler: Downscaler,
}

impl EdgeNet {
    /// The network that ships with the product.
    ///
    /// # Errors
    /// [`ErrorKind::NetworkRuntime`] if the runtime asked for cannot be had.
    pub fn embedded(options: &Options) -> Result<Self, Error> {
        Self::from_bytes(EMBEDDED, options).map_err(|e| e.in_context("embedded network"))
    }

    /// A network from an ONNX file.
    ///
    /// # Errors
    /// [`ErrorKind::Io`] if the file cannot be read; [`ErrorKind::ModelFile`] if it is broken or no edge network, that is,
    /// does not turn 1 x 3 x height x width values into 1 x 9 x rows x columns; [`ErrorKind::NetworkRuntime`] as
    /// [`Self::embedded`].
    pub fn from_path(path: &Path, options: &Options) -> Result<Self, Error> {
        let bytes = std::fs::read(path).map_err(|e| {
            Error::new(ErrorKind::Io, format!("{}: cannot read: {e}", path.display())).with_source(e)
        })?;
        Self::from_bytes(&bytes, options).map_err(|e| e.in_context(path.display()))
    }

    /// A network from the bytes of an ONNX file.
    ///
    /// # Errors
    /// As [`Self::from_path`].
    pub fn from_bytes(bytes: &[u8], options: &Options) -> Result<Self, Error> {
        let engine = Engine::load(bytes, options)?;
        let ([_, _, height, width], [_, channels, ..]) = (engine.input_shape(), engine.output_shape());
        if channels != CHANNELS {
            let text = format!("the network gives {channels} maps, {CHANNELS} are needed");
            return Err(Error::new(ErrorKind::ModelFile, text));
        }
        let downscaler = Downscaler::new([width, height]);
        // Too small for more than one thread.
        let single = Options { threads: NonZeroUsize::MIN, ..options.clone() };
        let lines = Engine::load(LINES, &single).map_err(|e| e.in_context("embedded network of lines"))?;
        Ok(Self {
            runtime_name: engine.runtime_name(),
            state: Mutex::new(State { engine, downscaler }),
            lines: Mutex::new(lines),
        })
    }

    /// What runs it: `ONNX Runtime` or `tract`.
    #[must_use]
    pub const fn runtime_name(&self) -> &'static str {
        self.runtime_name
    }
}

impl Network for EdgeNet {
    fn maps(&self, frame: &Frame) -> Result<FaceMaps, Error> {
        // A run that panicked leaves buffers half written, and the next run writes them anew.
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let State { engine, downscaler } = &mut *state;
        downscaler.run(frame, engine.input_mut());
        let values = engine.run()?;
        let bad = |text: &str| Error::new(ErrorKind::ModelFile, text);
        if !values.iter().all(|v| (-1e-3..=1.001).contains(v)) {
            return Err(bad("the network gives values that are no probabilities; its weights are broken"));
        }
        let [_, _, rows, columns] = engine.output_shape();
        FaceMaps::new(columns, rows, [frame.width_px(), frame.height_px()], values)
            .ok_or_else(|| bad("the network's maps are too small"))
    }

    fn line_log_odds(&self, strip: &LineStrip) -> Result<f32, Error> {
        let mut engine = self.lines.lock().unwrap_or_else(PoisonError::into_inner);
        let bad = |text: &str| Error::new(ErrorKind::ModelFile, text);
        let input = engine.input_mut();
        if input.len() != strip.values.len() {
            return Err(bad("the network of lines wants another strip"));
        }
        input.copy_from_slice(&strip.values);
        let told = engine.run()?;
        let told = told.first().copied().filter(|told| told.is_finite());
        told.ok_or_else(|| bad("the network of lines gives no number; its weights are broken"))
    }
}

impl std::fmt::Debug for EdgeNet {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "EdgeNet({})", self.runtime_name)
    }
}
