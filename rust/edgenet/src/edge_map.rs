//! The paper's kind of network (HED, IHED): a frame in, one map of stripes and edges out.

use crate::engine::{Engine, Options};
use crate::{COLOURS, probabilities, read};
use boxline::network::{EdgeMap, EdgeMapNetwork};
use boxline::{Error, ErrorKind, Frame};
use std::path::Path;

/// A loaded network of the paper's kind.
pub struct EdgeMapNet {
    engine: Engine,
}

impl EdgeMapNet {
    /// A network from an ONNX file that turns 1 x 3 x height x width values into 1 x 1 x rows x columns
    /// (`training/export.py` writes them).
    ///
    /// # Errors
    /// As [`crate::EdgeNet::from_path`].
    pub fn from_path(path: &Path, options: &Options) -> Result<Self, Error> {
        let load = || Self::from_engine(Engine::load(&read(path)?, COLOURS, options)?);
        load().map_err(|e| e.in_context(path.display()))
    }

    pub(crate) fn from_engine(engine: Engine) -> Result<Self, Error> {
        let [_, maps, ..] = engine.output_shape();
        if maps != 1 {
            let text = format!("the network gives {maps} maps, the paper's gives one");
            return Err(Error::new(ErrorKind::ModelFile, text));
        }
        Ok(Self { engine })
    }
}

impl EdgeMapNetwork for EdgeMapNet {
    fn edge_map(&self, frame: &Frame) -> Result<EdgeMap, Error> {
        let (values, [columns, rows]) = probabilities(&self.engine, frame)?;
        EdgeMap::new(columns, rows, [frame.width_px(), frame.height_px()], values)
            .ok_or_else(|| Error::new(ErrorKind::ModelFile, "the network's map is too small"))
    }
}

impl std::fmt::Debug for EdgeMapNet {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("EdgeMapNet")
    }
}
