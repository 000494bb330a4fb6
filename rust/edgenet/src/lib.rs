//! The edge network: a frame in, the nine maps of [`boxline::network`] out; the small network that looks at single lines, and the one
//! that sees the face in its own plane and says where its sides are.
//!
//! [`EdgeNet`] is what the product uses, [`EdgeMapNet`] the paper's kind of network, [`AnyNet`] whichever a file holds; `engine` below runs any ONNX file of the same kind on ONNX Runtime
//! (`onnx_runtime`, where its library is found) or on the engine inside (`forward`, always there).
//! Training, export and scores are Python, in `training/`.
#![forbid(unsafe_code)]

mod edge_map;
mod engine;
mod forward;
mod halves;
mod onnx;
mod onnx_runtime;

pub use edge_map::EdgeMapNet;
pub use engine::{Engine, Options, Runtime};

use boxline::image::small::Downscaler;
use boxline::network::{CHANNELS, EdgeMapNetwork, FaceMaps, LineStrip, Network, STRIP};
use boxline::view::{FaceView, Orientation, SideOdds, VIEW};
use boxline::{Error, ErrorKind, Frame};
use rayon::prelude::*;
use std::io::Read;
use std::num::NonZeroUsize;
use std::path::Path;

/// The weights that ship, packed as `halves` says; `models/boxnet.md` says where they come from.
const EMBEDDED: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/boxnet"));
/// The network of lines; `models/lines.md`.
const LINES: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/lines"));
/// The network of sides; `models/sides.md`.
const SIDES: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/sides"));

/// Channels of a picture.
const COLOURS: usize = 3;

/// A loaded network. Several threads may ask it at a time: with the engine inside each runs by itself, ONNX Runtime takes one after the other.
pub struct EdgeNet {
    maps: Engine,
    lines: Engine,
    sides: Engine,
    /// So many ways to see a face are asked at a time.
    at_a_time: usize,
}

/// What a network of frames says of one, and columns and rows of it.
fn probabilities(engine: &Engine, frame: &Frame) -> Result<(Vec<f32>, [usize; 2]), Error> {
    let [_, _, height, width] = engine.input_shape();
    let mut small = vec![0.0; engine.input_len()];
    Downscaler::new([width, height]).run(frame, &mut small);
    let values = engine.run(&small)?;
    if !values.iter().all(|v| (-1e-3..=1.001).contains(v)) {
        let text = "the network gives values that are no probabilities; its weights are broken";
        return Err(Error::new(ErrorKind::ModelFile, text));
    }
    let [_, _, rows, columns] = engine.output_shape();
    Ok((values, [columns, rows]))
}

/// Networks have some MB, the paper's 60.
const MOST_BYTES: u64 = 256 << 20;

fn read(path: &Path) -> Result<Vec<u8>, Error> {
    let io = |e: std::io::Error| Error::new(ErrorKind::Io, format!("cannot read: {e}")).with_source(e);
    // Opening a pipe waits, reading a device may never end.
    if !std::fs::metadata(path).map_err(io)?.is_file() {
        return Err(Error::new(ErrorKind::Io, "cannot read: it is not a plain file"));
    }
    let mut bytes = Vec::new();
    std::fs::File::open(path).map_err(io)?.take(MOST_BYTES + 1).read_to_end(&mut bytes).map_err(io)?;
    if bytes.len() as u64 > MOST_BYTES {
        let text = format!("larger than {MOST_BYTES} bytes, the most that is allowed");
        return Err(Error::new(ErrorKind::ModelFile, text));
    }
    Ok(bytes)
}

/// A network of either kind.
#[derive(Debug)]
pub enum AnyNet {
    /// The product's, of nine maps.
    Face(Box<EdgeNet>),
    /// The paper's, of one map.
    EdgeMap(Box<EdgeMapNet>),
}

impl AnyNet {
    /// Whichever network an ONNX file holds.
    ///
    /// # Errors
    /// As [`EdgeNet::from_path`].
    pub fn from_path(path: &Path, options: &Options) -> Result<Self, Error> {
        let load = || {
            let engine = Engine::load(&read(path)?, COLOURS, options)?;
            let [_, maps, ..] = engine.output_shape();
            if maps == 1 {
                EdgeMapNet::from_engine(engine).map(|net| Self::EdgeMap(Box::new(net)))
            } else {
                EdgeNet::from_engine(engine, options).map(|net| Self::Face(Box::new(net)))
            }
        };
        load().map_err(|e| e.in_context(path.display()))
    }

    /// The network for `boxline::Settings::network`.
    #[must_use]
    pub fn network(&self) -> Option<&dyn Network> {
        match self {
            Self::Face(net) => Some(net.as_ref()),
            Self::EdgeMap(_) => None,
        }
    }

    /// The network for `boxline::Settings::edge_map`.
    #[must_use]
    pub fn edge_map(&self) -> Option<&dyn EdgeMapNetwork> {
        match self {
            Self::Face(_) => None,
            Self::EdgeMap(net) => Some(net.as_ref()),
        }
    }
}

impl EdgeNet {
    /// The network that ships with the product.
    ///
    /// # Errors
    /// [`ErrorKind::NetworkRuntime`] if the runtime asked for cannot be had.
    pub fn embedded(options: &Options) -> Result<Self, Error> {
        Self::from_bytes(&halves::unpacked(EMBEDDED), options).map_err(|e| e.in_context("embedded network"))
    }

    /// A network from an ONNX file.
    ///
    /// # Errors
    /// [`ErrorKind::Io`] if the file cannot be read; [`ErrorKind::ModelFile`] if it is broken or no edge network, that is,
    /// does not turn 1 x 3 x height x width values into 1 x 9 x rows x columns; [`ErrorKind::NetworkRuntime`] as
    /// [`Self::embedded`].
    pub fn from_path(path: &Path, options: &Options) -> Result<Self, Error> {
        let load = || Self::from_bytes(&read(path)?, options);
        load().map_err(|e| e.in_context(path.display()))
    }

    /// A network from the bytes of an ONNX file.
    ///
    /// # Errors
    /// As [`Self::from_path`].
    pub fn from_bytes(bytes: &[u8], options: &Options) -> Result<Self, Error> {
        Self::from_engine(Engine::load(bytes, COLOURS, options)?, options)
    }

    fn from_engine(engine: Engine, options: &Options) -> Result<Self, Error> {
        let [_, channels, ..] = engine.output_shape();
        if channels != CHANNELS {
            let text = format!("the network gives {channels} maps, {CHANNELS} are needed");
            return Err(Error::new(ErrorKind::ModelFile, text));
        }
        // Too small for more than one thread.
        let single = Options { threads: NonZeroUsize::MIN, ..options.clone() };
        let mut lines = Engine::load(&halves::unpacked(LINES), STRIP[0], &single)
            .map_err(|e| e.in_context("embedded network of lines"))?;
        // ONNX Runtime answers one question at a time, with all threads. The engine inside is better asked several at a time.
        let at_a_time = if engine.is_embedded() { options.threads.get() } else { 1 };
        let options = if at_a_time > 1 { &single } else { options };
        let mut sides = Engine::load(&halves::unpacked(SIDES), VIEW[0], options)
            .map_err(|e| e.in_context("embedded network of sides"))?;
        lines.share_memory(&engine);
        sides.share_memory(&engine);
        Ok(Self { maps: engine, lines, sides, at_a_time })
    }

    /// What the network of sides says of a view seen in one way; [`Network::sides`] asks in all.
    ///
    /// # Errors
    /// The view has another size, or the runtime fails.
    pub fn sides_seen(&self, view: &FaceView, orientation: Orientation) -> Result<SideOdds, Error> {
        const OTHER_VIEW: &str = "sides wants another view";
        if view.values.len() != VIEW.iter().product::<usize>() {
            return Err(bad_network(OTHER_VIEW));
        }
        let logits = run(&self.sides, &view.turned(orientation).values, OTHER_VIEW)?;
        let broken = || bad_network("sides gives no probabilities; its weights are broken");
        SideOdds::from_logits(&logits).ok_or_else(broken)
    }

    /// What runs it: `ONNX Runtime` or `embedded`.
    #[must_use]
    pub const fn runtime_name(&self) -> &'static str {
        self.maps.runtime_name()
    }
}

impl Network for EdgeNet {
    fn maps(&self, frame: &Frame) -> Result<FaceMaps, Error> {
        let (values, [columns, rows]) = probabilities(&self.maps, frame)?;
        FaceMaps::new(columns, rows, [frame.width_px(), frame.height_px()], values)
            .ok_or_else(|| Error::new(ErrorKind::ModelFile, "the network's maps are too small"))
    }

    fn sides(&self, view: &FaceView) -> Result<Option<SideOdds>, Error> {
        let ask =
            |orientation: &Orientation| self.sides_seen(view, *orientation).map(|odds| (*orientation, odds));
        let orientations = Orientation::ALL.as_slice();
        let answers = if self.at_a_time > 1 {
            let orientations =
                orientations.par_iter().with_min_len(orientations.len().div_ceil(self.at_a_time));
            orientations.map(ask).collect::<Result<Vec<_>, _>>()?
        } else {
            orientations.iter().map(ask).collect::<Result<Vec<_>, _>>()?
        };
        Ok(SideOdds::of_orientations(&answers))
    }

    fn line_log_odds(&self, strip: &LineStrip) -> Result<f32, Error> {
        let output = run(&self.lines, &strip.values, "lines wants another strip")?;
        let log_odds = output.first().copied().filter(|value| value.is_finite());
        log_odds.ok_or_else(|| bad_network("lines gives no number; its weights are broken"))
    }
}

fn bad_network(of: &str) -> Error {
    Error::new(ErrorKind::ModelFile, format!("the network of {of}"))
}

/// What one of the small networks says of an input; `other` is what is wrong with one of another size.
fn run(engine: &Engine, input: &[f32], other: &str) -> Result<Vec<f32>, Error> {
    if input.len() != engine.input_len() {
        return Err(bad_network(other));
    }
    engine.run(input)
}

impl std::fmt::Debug for EdgeNet {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "EdgeNet({})", self.runtime_name())
    }
}
