//! The engine inside: runs the few operators of our networks, and needs nothing. `build` makes steps of an ONNX file, with what
//! `operators` says of each of its nodes; `conv` and `ops` are what the steps do. Why not another's: `rust/decisions/0005`.

mod build;
mod conv;
mod operators;
mod ops;
mod sizes;
#[cfg(test)]
mod tests;

use crate::engine::checked_shapes;
use crate::onnx::Model;
use boxline::Error;
use conv::Scratch;
use ops::Op;
use std::sync::{Arc, Mutex, PoisonError};

/// Values of one array, at most: a map of full width of the paper's network has 13 million.
const MOST_VALUES: usize = 1 << 25;

/// How many values an array of these sizes has; nothing if they are too many.
pub(crate) fn len_of(sizes: &[usize]) -> Option<usize> {
    // Without those that are 0: behind one the others may still be anything.
    let most = sizes.iter().try_fold(1usize, |len, size| len.checked_mul((*size).max(1)))?;
    (most <= MOST_VALUES).then(|| if sizes.contains(&0) { 0 } else { most })
}

/// A network as steps, one after the other.
pub(crate) struct Plan {
    steps: Vec<Step>,
    result: Source,
    /// Values that each buffer must hold, the largest first. Arrays that are never needed at the same time share one.
    buffers: Vec<usize>,
    shapes: [[usize; 4]; 2],
    threads: usize,
    /// Memory of runs that are over, for the next ones: fresh pages would cost more time than some of the steps.
    idle: Arc<Mutex<Vec<Memory>>>,
}

struct Step {
    op: Op,
    inputs: Vec<Source>,
    /// Its buffer, and how many values it makes.
    output: usize,
    len: usize,
}

enum Source {
    Input,
    /// The first so many values of a buffer.
    Buffer(usize, usize),
    Constant(Vec<f32>),
}

/// What a run works with.
#[derive(Default)]
struct Memory {
    buffers: Vec<Vec<f32>>,
    scratch: Vec<Scratch>,
}

impl Plan {
    /// From the bytes of an ONNX file.
    ///
    /// # Errors
    /// [`boxline::ErrorKind::ModelFile`]: damaged, not of one image, or with an operator that is not here.
    pub fn load(model: &[u8], channels: usize, threads: usize) -> Result<Self, Error> {
        build::plan(Model::from_bytes(model)?, channels, threads)
    }

    /// Numbers the buffers by their size, so that those of another network fit into them.
    fn largest_buffers_first(&mut self) {
        let mut order: Vec<usize> = (0..self.buffers.len()).collect();
        order.sort_by_key(|number| std::cmp::Reverse(self.buffers[*number]));
        let mut number_of = vec![0; order.len()];
        order.iter().enumerate().for_each(|(new, old)| number_of[*old] = new);
        self.buffers = order.iter().map(|old| self.buffers[*old]).collect();
        for step in &mut self.steps {
            step.output = number_of[step.output];
        }
        let sources = self.steps.iter_mut().flat_map(|step| &mut step.inputs).chain([&mut self.result]);
        for source in sources {
            if let Source::Buffer(number, _) = source {
                *number = number_of[*number];
            }
        }
    }

    pub const fn shapes(&self) -> [[usize; 4]; 2] {
        self.shapes
    }

    /// From now on uses the memory of another network's runs, which are not at the same time on one thread.
    pub fn share_memory(&mut self, other: &Self) {
        self.idle = Arc::clone(&other.idle);
    }

    /// The output for an input of the right length.
    pub fn run(&self, input: &[f32]) -> Vec<f32> {
        let idle = self.idle.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let mut memory = idle.unwrap_or_default();
        memory.make_room(&self.buffers, self.threads);
        if self.threads > 1 {
            // On a thread of the pool, from which others take their part without a detour for each step.
            rayon::scope(|_| self.take_steps(input, &mut memory));
        } else {
            self.take_steps(input, &mut memory);
        }
        let output = self.result.values(input, &memory.buffers).to_vec();
        self.idle.lock().unwrap_or_else(PoisonError::into_inner).push(memory);
        output
    }

    fn take_steps(&self, input: &[f32], memory: &mut Memory) {
        for step in &self.steps {
            let mut out = std::mem::take(&mut memory.buffers[step.output]);
            {
                let inputs: Vec<&[f32]> =
                    step.inputs.iter().map(|source| source.values(input, &memory.buffers)).collect();
                step.op.run(&inputs, &mut out[..step.len], &mut memory.scratch[..self.threads]);
            }
            memory.buffers[step.output] = out;
        }
    }
}

impl Memory {
    fn make_room(&mut self, buffers: &[usize], threads: usize) {
        self.buffers.resize_with(self.buffers.len().max(buffers.len()), Vec::new);
        for (buffer, len) in self.buffers.iter_mut().zip(buffers).filter(|(buffer, len)| buffer.len() < **len)
        {
            *buffer = vec![0.0; *len]; // anew: what an old run left is not copied
        }
        self.scratch.resize_with(self.scratch.len().max(threads), Scratch::default);
    }
}

impl Source {
    fn values<'a>(&'a self, input: &'a [f32], buffers: &'a [Vec<f32>]) -> &'a [f32] {
        match self {
            Self::Input => input,
            Self::Buffer(number, len) => &buffers[*number][..*len],
            Self::Constant(values) => values,
        }
    }
}
