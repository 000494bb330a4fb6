//! The embedded engine. tract itself rather than through `ort`'s adaptor: `rust/decisions/0004`.

use crate::engine::checked_shapes;
use boxline::{Error, ErrorKind};
use std::panic::{AssertUnwindSafe, catch_unwind};
use tract_linalg::multithread::Executor;
use tract_onnx::prelude::*;

/// A network in tract.
pub(crate) struct TractPlan {
    plan: Arc<TypedRunnableModel>,
    shapes: [[usize; 4]; 2],
}

impl TractPlan {
    pub(crate) fn load(model: &[u8], channels: usize, threads: usize) -> Result<Self, Error> {
        // Shapes first: they bound what the network can ask for.
        let (model, shapes) = guarded(|| parsed(model)).map_err(|text| {
            Error::new(ErrorKind::ModelFile, format!("tract cannot read the network: {text}"))
        })?;
        let shapes = checked_shapes(&shapes[0], &shapes[1], channels)?;
        let executor = if threads > 1 { Executor::multithread(threads) } else { Executor::SingleThread };
        let options = RunOptions { executor: Some(executor), ..RunOptions::default() };
        let plan =
            guarded(|| model.into_optimized()?.into_runnable_with_options(&options)).map_err(|text| {
                Error::new(ErrorKind::ModelFile, format!("tract cannot prepare the network: {text}"))
            })?;
        Ok(Self { plan, shapes })
    }

    pub(crate) const fn shapes(&self) -> [[usize; 4]; 2] {
        self.shapes
    }

    pub(crate) fn run(&self, input: &[f32]) -> Result<Vec<f32>, Error> {
        guarded(|| {
            let input = Tensor::from_shape(&self.shapes[0], input)?;
            let outputs = self.plan.run(tvec!(input.into_tvalue()))?;
            Ok(outputs[0].view().as_slice::<f32>()?.to_vec())
        })
        .map_err(|text| Error::new(ErrorKind::NetworkRuntime, format!("tract failed: {text}")))
    }
}

/// Shapes of several tensors; -1 stands for what is not fixed.
type Shapes = Vec<Vec<i64>>;

/// The graph with the shapes of its inputs and outputs; tensors that are not of f32 have none.
fn parsed(mut model: &[u8]) -> TractResult<(TypedModel, [Shapes; 2])> {
    let typed = tract_onnx::onnx().model_for_read(&mut model)?.into_typed()?;
    let shapes = |outlets: &[OutletId]| -> TractResult<Shapes> {
        let of = |fact: &TypedFact| -> Vec<i64> {
            let floats = fact.datum_type == f32::datum_type();
            let sizes = fact.shape.iter().filter(|_| floats);
            sizes.map(|size| size.to_i64().unwrap_or(-1)).collect()
        };
        outlets.iter().map(|outlet| typed.outlet_fact(*outlet).map(of)).collect()
    };
    let shapes = [shapes(&typed.inputs)?, shapes(&typed.outputs)?];
    Ok((typed, shapes))
}

/// Runs a part of tract whose input is a file from outside. tract asserts things about files that a broken one does not keep;
/// such a panic is an error of the file, not of the program. Nothing outlives a panic here, so nothing half made is seen.
fn guarded<T>(run: impl FnOnce() -> TractResult<T>) -> Result<T, String> {
    match catch_unwind(AssertUnwindSafe(run)) {
        Ok(result) => result.map_err(|e| format!("{e:#}")),
        Err(panic) => {
            let text = panic.downcast_ref::<String>().map(String::as_str);
            Err(text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("it panicked").to_owned())
        }
    }
}
