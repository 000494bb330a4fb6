//! ONNX Runtime through the crate `ort`: finds its library, loads it once per process, runs sessions.

use crate::engine::checked_shapes;
use boxline::{Error, ErrorKind};
use ort::environment::Environment;
use ort::session::Session;
use ort::session::builder::{GraphOptimizationLevel, SessionBuilder};
use ort::value::{TensorElementType, TensorRef};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// ort's own convention.
const VARIABLE: &str = "ORT_DYLIB_PATH";

/// The library and its environment exist once per process.
static STATE: Mutex<State> = Mutex::new(State::Untried);

enum State {
    Untried,
    Loaded(PathBuf, Environment),
    /// No second attempt: ort keeps a library that loaded and did not start, and gives it for any other that is named then.
    Failed(String),
}

/// The runtime, if its library is where [`crate::Runtime::Auto`] looks.
///
/// # Errors
/// The variable names a library that cannot be loaded.
pub(crate) fn find() -> Result<Option<Environment>, Error> {
    if let Some(path) = std::env::var_os(VARIABLE).filter(|v| !v.is_empty()) {
        return load(Path::new(&path)).map(Some).map_err(|e| e.in_context(VARIABLE));
    }
    let name = format!("{}onnxruntime{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX);
    let beside = std::env::current_exe().ok().map(|program| program.with_file_name(&name));
    match beside.filter(|path| path.is_file()) {
        Some(path) => load(&path).map(Some),
        // The loader of an app knows its library folder, nobody else does; an app without the library goes on without.
        None if cfg!(target_os = "android") => Ok(load(Path::new(&name)).ok()),
        None => Ok(None),
    }
}

/// The runtime from this library: a path, or on Android a bare name.
///
/// # Errors
/// [`ErrorKind::NetworkRuntime`] if it cannot be loaded, is too old, or another attempt was made before.
pub(crate) fn load(library: &Path) -> Result<Environment, Error> {
    let failed = |text: String| Error::new(ErrorKind::NetworkRuntime, text);
    let mut state = STATE.lock().unwrap_or_else(PoisonError::into_inner);
    match &*state {
        State::Loaded(path, environment) if path == library => return Ok(environment.clone()),
        State::Loaded(path, _) => {
            let (wanted, path) = (library.display(), path.display());
            return Err(failed(format!(
                "{wanted}: {path} is loaded already, a process can load one ONNX Runtime"
            )));
        }
        State::Failed(text) => {
            let wanted = library.display();
            return Err(failed(format!(
                "{wanted}: not tried, a process can try one library; before: {text}"
            )));
        }
        State::Untried => {}
    }
    if !cfg!(target_os = "android") && !library.is_file() {
        return Err(failed(format!("{}: no such library", library.display())));
    }
    match started(library) {
        Ok(environment) => {
            *state = State::Loaded(library.to_owned(), environment.clone());
            Ok(environment)
        }
        Err(text) => {
            let text = format!("{}: {text}", library.display());
            *state = State::Failed(text.clone());
            Err(failed(text))
        }
    }
}

fn started(library: &Path) -> Result<Environment, String> {
    let builder = ort::init_from(library).map_err(|e| format!("cannot load ONNX Runtime: {e}"))?;
    let environment = builder.with_name("boxline").with_telemetry(false).build();
    environment.map_err(|e| format!("ONNX Runtime does not start: {e}"))
}

/// A network in ONNX Runtime. One input at a time: several threads wait for each other.
pub(crate) struct OnnxSession {
    session: Mutex<Session>,
    shapes: [[usize; 4]; 2],
}

impl OnnxSession {
    pub(crate) fn load(
        environment: &Environment,
        model: &[u8],
        channels: usize,
        threads: usize,
    ) -> Result<Self, Error> {
        let mut builder = configured(environment, threads).map_err(|e| {
            Error::new(ErrorKind::NetworkRuntime, format!("ONNX Runtime gives no session: {e}"))
        })?;
        let session = builder.commit_from_memory(model).map_err(|e| {
            Error::new(ErrorKind::ModelFile, format!("ONNX Runtime cannot read the network: {e}"))
        })?;
        let shapes_of = |outlets: &[ort::value::Outlet]| -> Vec<Vec<i64>> {
            let of = |outlet: &ort::value::Outlet| {
                let floats = outlet.dtype().tensor_type() == Some(TensorElementType::Float32);
                // Something else has no shape that could be accepted.
                outlet.dtype().tensor_shape().filter(|_| floats).map_or_else(Vec::new, |shape| shape.to_vec())
            };
            outlets.iter().map(of).collect()
        };
        let shapes = checked_shapes(&shapes_of(session.inputs()), &shapes_of(session.outputs()), channels)?;
        Ok(Self { session: Mutex::new(session), shapes })
    }

    pub(crate) const fn shapes(&self) -> [[usize; 4]; 2] {
        self.shapes
    }

    pub(crate) fn run(&self, input: &[f32]) -> Result<Vec<f32>, Error> {
        let failed =
            |e: ort::Error| Error::new(ErrorKind::NetworkRuntime, format!("ONNX Runtime failed: {e}"));
        let input = TensorRef::from_array_view((self.shapes[0], input)).map_err(failed)?;
        let mut session = self.session.lock().unwrap_or_else(PoisonError::into_inner);
        let outputs = session.run(ort::inputs![input]).map_err(failed)?;
        let (_, values) = outputs[0].try_extract_tensor::<f32>().map_err(failed)?;
        Ok(values.to_vec())
    }
}

fn configured(environment: &Environment, threads: usize) -> ort::Result<SessionBuilder> {
    Ok(Session::builder(environment)?
        .with_optimization_level(GraphOptimizationLevel::All)?
        .with_intra_threads(threads)?
        // Threads that wait for the next frame should sleep: frames are rare and a phone has a battery.
        .with_intra_op_spinning(false)?)
}
