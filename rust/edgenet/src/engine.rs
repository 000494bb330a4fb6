//! Runs an ONNX file that turns one image into maps, on one of two runtimes. Knows nothing of what the maps mean.

use crate::forward::Plan;
use crate::onnx_runtime::{self, OnnxSession};
use boxline::{Error, ErrorKind};
use std::num::NonZeroUsize;
use std::path::PathBuf;

/// What runs the network.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Runtime {
    /// ONNX Runtime if its library is found, else the engine inside. It is looked for where the variable `ORT_DYLIB_PATH` says, without it
    /// next to the program, on Android also among the app's own libraries. One that is there but cannot be loaded is
    /// an error.
    #[default]
    Auto,
    /// ONNX Runtime, 1.17 or newer, from this library. A process can try one library only.
    OnnxRuntime(PathBuf),
    /// The engine inside the program: the operators of our networks and no others.
    Embedded,
}

/// How a network is run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Options {
    /// What runs it.
    pub runtime: Runtime,
    /// Threads it may use, the caller's among them.
    pub threads: NonZeroUsize,
}

/// The network is too small to keep more threads busy (and a phone has four fast cores).
const MOST_THREADS: NonZeroUsize = NonZeroUsize::new(4).expect("4 is not 0");

impl Default for Options {
    /// Runtime as found, as many threads as the machine runs at once, at most four.
    fn default() -> Self {
        let threads = std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN).min(MOST_THREADS);
        Self { runtime: Runtime::Auto, threads }
    }
}

/// Largest side of input and output that is accepted: a file must not make the program take all memory.
const MOST_PX: usize = 4096;

/// A network ready to run, by several threads at a time if they like.
pub struct Engine {
    loaded: Loaded,
    input_shape: [usize; 4],
    output_shape: [usize; 4],
}

/// The two kinds.
enum Loaded {
    OnnxRuntime(OnnxSession),
    Embedded(Plan),
}

impl Engine {
    /// Loads the bytes of an ONNX file with one input of so many channels and one output, both of four fixed dimensions.
    ///
    /// # Errors
    /// [`ErrorKind::ModelFile`] or [`ErrorKind::NetworkRuntime`].
    pub fn load(model: &[u8], channels: usize, options: &Options) -> Result<Self, Error> {
        let threads = options.threads.get();
        let library = match &options.runtime {
            Runtime::Auto => onnx_runtime::find()?,
            Runtime::OnnxRuntime(path) => Some(onnx_runtime::load(path)?),
            Runtime::Embedded => None,
        };
        let loaded = match library {
            Some(environment) => {
                Loaded::OnnxRuntime(OnnxSession::load(&environment, model, channels, threads)?)
            }
            None => Loaded::Embedded(Plan::load(model, channels, threads)?),
        };
        let [input_shape, output_shape] = match &loaded {
            Loaded::OnnxRuntime(session) => session.shapes(),
            Loaded::Embedded(plan) => plan.shapes(),
        };
        Ok(Self { loaded, input_shape, output_shape })
    }

    /// Batch (1), channels, rows, columns.
    #[must_use]
    pub const fn input_shape(&self) -> [usize; 4] {
        self.input_shape
    }

    /// Batch (1), maps, rows, columns.
    #[must_use]
    pub const fn output_shape(&self) -> [usize; 4] {
        self.output_shape
    }

    /// `ONNX Runtime` or `embedded`.
    #[must_use]
    pub const fn runtime_name(&self) -> &'static str {
        match self.loaded {
            Loaded::OnnxRuntime(_) => "ONNX Runtime",
            Loaded::Embedded(_) => "embedded",
        }
    }

    pub(crate) const fn is_embedded(&self) -> bool {
        matches!(self.loaded, Loaded::Embedded(_))
    }

    /// Values of an input.
    #[must_use]
    pub fn input_len(&self) -> usize {
        self.input_shape.iter().product()
    }

    /// Lets it work in the memory of another engine: less is held, and the two are not asked at the same time on one thread.
    pub(crate) fn share_memory(&mut self, other: &Self) {
        if let (Loaded::Embedded(own), Loaded::Embedded(other)) = (&mut self.loaded, &other.loaded) {
            own.share_memory(other);
        }
    }

    /// Runs the network on an input: one channel after the other, rows top to bottom. Gives the values of the output, laid out like it.
    ///
    /// # Errors
    /// [`ErrorKind::NetworkRuntime`]: the input has another size, or the runtime failed.
    pub fn run(&self, input: &[f32]) -> Result<Vec<f32>, Error> {
        if input.len() != self.input_len() {
            let text = format!("the network wants {} values, {} were given", self.input_len(), input.len());
            return Err(Error::new(ErrorKind::NetworkRuntime, text));
        }
        match &self.loaded {
            Loaded::OnnxRuntime(session) => session.run(input),
            Loaded::Embedded(plan) => Ok(plan.run(input)),
        }
    }
}

/// The shapes of a file's inputs and outputs, if they are those of one image and its maps. Negative: not fixed.
pub(crate) fn checked_shapes(
    inputs: &[Vec<i64>],
    outputs: &[Vec<i64>],
    channels: usize,
) -> Result<[[usize; 4]; 2], Error> {
    let bad = |text: String| Err(Error::new(ErrorKind::ModelFile, text));
    let ([input], [output]) = (inputs, outputs) else {
        let text = format!(
            "the network has {} inputs and {} outputs, one each is needed",
            inputs.len(),
            outputs.len()
        );
        return bad(text);
    };
    let as_sizes = |shape: &[i64]| -> Option<[usize; 4]> {
        let sizes: Vec<usize> = shape.iter().filter_map(|d| usize::try_from(*d).ok()).collect();
        <[usize; 4]>::try_from(sizes)
            .ok()
            .filter(|s| s[0] == 1 && s.iter().all(|n| (1..=MOST_PX).contains(n)))
    };
    match (as_sizes(input).filter(|s| s[1] == channels), as_sizes(output)) {
        (Some(input), Some(output)) => Ok([input, output]),
        (None, _) => {
            bad(format!("the network's input is {input:?}, 1 x {channels} x height x width is needed"))
        }
        (_, None) => bad(format!("the network's output is {output:?}, 1 x maps x height x width is needed")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_one_image_in_and_maps_out_of_it_are_accepted() {
        let good = (vec![1, 3, 384, 512], vec![1, 9, 192, 256]);
        let checked =
            |input: &[i64], output: &[i64]| checked_shapes(&[input.to_vec()], &[output.to_vec()], 3);
        assert_eq!(checked(&good.0, &good.1).expect("good"), [[1, 3, 384, 512], [1, 9, 192, 256]]);
        for input in [
            &[1, 4, 384, 512][..],
            &[2, 3, 384, 512],
            &[1, 3, -1, 512],
            &[1, 3, 384],
            &[1, 3, 0, 4],
            &[1, 3, 4, 1 << 40],
        ] {
            let e = checked(input, &good.1).expect_err("wrong input");
            assert!(e.kind() == ErrorKind::ModelFile && e.to_string().contains("input is"), "{e}");
        }
        assert!(checked(&good.0, &[9, 192, 256]).is_err());
        assert!(checked_shapes(&[], std::slice::from_ref(&good.1), 3).is_err());
        assert!(checked_shapes(std::slice::from_ref(&good.0), &[good.1.clone(), good.1], 3).is_err());
    }
}
