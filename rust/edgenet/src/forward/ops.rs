//! What a step of the engine does, beside convolutions (`conv`). All sizes are fixed when the network is loaded; where a value is
//! found that must be moved or repeated is a table made then.

use super::conv::{AddedMap, Conv, Epilogue, Scratch, Window};
use pulp::{Arch, Simd, WithSimd};

/// One operation.
pub(crate) enum Op {
    /// Inputs: the map; what is added to the sums, if anything is.
    Conv { conv: Box<Conv>, halved: bool, relu: bool },
    /// Each value of the output is a copy of the input's value at this place.
    Take(Vec<u32>),
    /// Inputs one after the other, so many values of each in turn.
    Join(Vec<usize>),
    /// Two numbers make one.
    Binary { kind: BinaryOp, spread: [Spread; 2] },
    /// One number makes one.
    Unary(UnaryOp),
    /// All values along some neighbouring axes make one.
    Reduce { kind: Reduce, lanes: Lanes },
    /// Exponentials, divided by their sum.
    Softmax(Lanes),
    /// Rows of the input times a matrix, whose columns lie one after the other, plus a bias.
    Product { columns: Vec<f32>, bias: Vec<f32> },
    /// The largest value of each window.
    MaxPool { window: Window, input: [usize; 2], output: [usize; 2] },
    /// Linear in rows and columns between the nearest two.
    Linear { rows: Vec<LinearSample>, columns: Vec<LinearSample>, input: [usize; 2] },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum BinaryOp {
    Add,
    Sub,
    Mul,
    Div,
    Pow,
}

/// How an operand meets the output's places.
pub(crate) enum Spread {
    /// One to one.
    Same,
    /// Its only value meets all.
    One,
    /// All of it over and over: an axis before its own is repeated.
    Cycle,
    /// The value at this place.
    Table(Vec<u32>),
}

impl Spread {
    /// Which of `len` values meets the output's number `n`.
    pub fn place(&self, n: usize, len: usize) -> usize {
        match self {
            Self::Same => n,
            Self::One => 0,
            Self::Cycle => n % len,
            Self::Table(places) => places[n] as usize,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum UnaryOp {
    Relu,
    Sigmoid,
    Sqrt,
    Abs,
    Clip(f32, f32),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Reduce {
    Mean,
    Sum,
    Max,
}

/// An array as blocks, in each of which `len` rows of `inner` values lie one after the other.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lanes {
    pub len: usize,
    pub inner: usize,
}

/// A place between two others.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LinearSample {
    pub first: usize,
    pub second: usize,
    /// Weight of the second.
    pub share: f32,
}

impl Op {
    /// Fills the output; the lengths of all are those that the network was loaded with.
    pub fn run(&self, inputs: &[&[f32]], out: &mut [f32], scratch: &mut [Scratch]) {
        let Some(input) = inputs.first().copied() else { return };
        match self {
            Self::Conv { conv, halved, relu } => {
                let add = inputs.get(1).map(|values| AddedMap { values, halved: *halved });
                conv.run(input, Epilogue { add, relu: *relu }, out, scratch);
            }
            Self::Take(places) => take(input, places, out),
            Self::Join(parts) => join(inputs, parts, out),
            Self::Binary { kind, spread } => {
                let Some(second) = inputs.get(1) else { return };
                match kind {
                    BinaryOp::Add => pair(input, second, spread, out, |a, b| a + b),
                    BinaryOp::Sub => pair(input, second, spread, out, |a, b| a - b),
                    BinaryOp::Mul => pair(input, second, spread, out, |a, b| a * b),
                    BinaryOp::Div => pair(input, second, spread, out, |a, b| a / b),
                    BinaryOp::Pow => {
                        pair(input, second, spread, out, |a, b| if b == 2.0 { a * a } else { a.powf(b) })
                    }
                }
            }
            Self::Unary(kind) => {
                let all = |out: &mut [f32], f: fn(f32) -> f32| {
                    out.iter_mut().zip(input).for_each(|(out, v)| *out = f(*v));
                };
                match *kind {
                    UnaryOp::Relu => all(out, |v| if v < 0.0 { 0.0 } else { v }),
                    UnaryOp::Sigmoid => Arch::new().dispatch(Sigmoid { input, out }),
                    UnaryOp::Sqrt => all(out, f32::sqrt),
                    UnaryOp::Abs => all(out, f32::abs),
                    UnaryOp::Clip(least, most) => {
                        // Not `clamp`, which wants ordered bounds; ONNX does not.
                        out.iter_mut().zip(input).for_each(|(out, v)| *out = v.max(least).min(most));
                    }
                }
            }
            Self::Reduce { kind, lanes } => reduce(*kind, *lanes, input, out),
            Self::Softmax(lanes) => softmax(*lanes, input, out),
            Self::Product { columns, bias } => {
                let taps = columns.len() / bias.len();
                for (row, out) in input.chunks_exact(taps).zip(out.chunks_exact_mut(bias.len())) {
                    for ((out, column), bias) in out.iter_mut().zip(columns.chunks_exact(taps)).zip(bias) {
                        *out = bias + row.iter().zip(column).map(|(a, b)| a * b).sum::<f32>();
                    }
                }
            }
            Self::MaxPool { window, input: sizes, output } => max_pool(window, *sizes, *output, input, out),
            Self::Linear { rows, columns, input: sizes } => linear(rows, columns, *sizes, input, out),
        }
    }
}

pub(crate) fn take<T: Copy>(input: &[T], places: &[u32], out: &mut [T]) {
    out.iter_mut().zip(places).for_each(|(out, place)| *out = input[*place as usize]);
}

pub(crate) fn join<T: Copy>(inputs: &[&[T]], parts: &[usize], out: &mut [T]) {
    let block = parts.iter().sum::<usize>().max(1);
    for (number, out) in out.chunks_exact_mut(block).enumerate() {
        let mut at = 0;
        for (input, part) in inputs.iter().zip(parts) {
            out[at..at + part].copy_from_slice(&input[number * part..][..*part]);
            at += part;
        }
    }
}

fn pair(a: &[f32], b: &[f32], spread: &[Spread; 2], out: &mut [f32], f: impl Fn(f32, f32) -> f32) {
    match spread {
        [Spread::Same, Spread::Same] => {
            out.iter_mut().zip(a).zip(b).for_each(|((out, a), b)| *out = f(*a, *b));
        }
        [Spread::Same, Spread::One] => out.iter_mut().zip(a).for_each(|(out, a)| *out = f(*a, b[0])),
        [Spread::One, Spread::Same] => out.iter_mut().zip(b).for_each(|(out, b)| *out = f(a[0], *b)),
        [Spread::Same, Spread::Cycle] => {
            for (out, a) in out.chunks_exact_mut(b.len()).zip(a.chunks_exact(b.len())) {
                out.iter_mut().zip(a).zip(b).for_each(|((out, a), b)| *out = f(*a, *b));
            }
        }
        [first, second] => {
            let at = |values: &[f32], spread: &Spread, n: usize| values[spread.place(n, values.len())];
            out.iter_mut().enumerate().for_each(|(n, out)| *out = f(at(a, first, n), at(b, second, n)));
        }
    }
}

fn reduce(kind: Reduce, lanes: Lanes, input: &[f32], out: &mut [f32]) {
    let Lanes { len, inner } = lanes;
    for (block, out) in input.chunks_exact(len * inner).zip(out.chunks_exact_mut(inner)) {
        if inner == 1 {
            // Many values: added up in parts, so that a large sum does not swallow small ones.
            let parts = block.chunks(64);
            out[0] = match kind {
                Reduce::Max => block.iter().copied().fold(f32::NEG_INFINITY, larger),
                Reduce::Sum | Reduce::Mean => parts.map(|part| part.iter().sum::<f32>()).sum(),
            };
        } else {
            let (first, others) = block.split_at(inner);
            out.copy_from_slice(first);
            for row in others.chunks_exact(inner) {
                match kind {
                    Reduce::Max => out.iter_mut().zip(row).for_each(|(out, v)| *out = larger(*out, *v)),
                    Reduce::Sum | Reduce::Mean => out.iter_mut().zip(row).for_each(|(out, v)| *out += v),
                }
            }
        }
        if kind == Reduce::Mean {
            out.iter_mut().for_each(|out| *out /= len as f32);
        }
    }
}

/// What is no number stays so.
fn larger(a: f32, b: f32) -> f32 {
    if a > b || a.is_nan() { a } else { b }
}

fn softmax(lanes: Lanes, input: &[f32], out: &mut [f32]) {
    let Lanes { len, inner } = lanes;
    for (block, out) in input.chunks_exact(len * inner).zip(out.chunks_exact_mut(len * inner)) {
        let mut most = vec![f32::NEG_INFINITY; inner];
        for row in block.chunks_exact(inner) {
            most.iter_mut().zip(row).for_each(|(most, v)| *most = larger(*most, *v));
        }
        let mut sum = vec![0.0; inner];
        for (row, out) in block.chunks_exact(inner).zip(out.chunks_exact_mut(inner)) {
            for (((out, v), most), sum) in out.iter_mut().zip(row).zip(&most).zip(&mut sum) {
                *out = exponential(v - most);
                *sum += *out;
            }
        }
        for out in out.chunks_exact_mut(inner) {
            out.iter_mut().zip(&sum).for_each(|(out, sum)| *out /= sum);
        }
    }
}

fn max_pool(window: &Window, input: [usize; 2], output: [usize; 2], values: &[f32], out: &mut [f32]) {
    let [rows, columns] = input;
    let planes = values.chunks_exact(rows * columns).zip(out.chunks_exact_mut(output[0] * output[1]));
    // The part of a window that is in the picture; padding is never the largest.
    let range = |axis: usize, n: usize| {
        let start = n * window.strides[axis];
        let end = (start + window.size[axis]).saturating_sub(window.pads[axis][0]).min(input[axis]);
        start.saturating_sub(window.pads[axis][0]).min(end)..end
    };
    for (values, out) in planes {
        for (y, out) in out.chunks_exact_mut(output[1]).enumerate() {
            for (x, out) in out.iter_mut().enumerate() {
                *out = f32::NEG_INFINITY;
                for row in range(0, y) {
                    let seen = &values[row * columns..][..columns][range(1, x)];
                    *out = seen.iter().copied().fold(*out, larger);
                }
            }
        }
    }
}

fn linear(
    rows: &[LinearSample],
    columns: &[LinearSample],
    input: [usize; 2],
    values: &[f32],
    out: &mut [f32],
) {
    let planes = values.chunks_exact(input[0] * input[1]);
    for (values, out) in planes.zip(out.chunks_exact_mut(rows.len() * columns.len())) {
        for (y, out) in rows.iter().zip(out.chunks_exact_mut(columns.len())) {
            let row = |n: usize| &values[n * input[1]..][..input[1]];
            let (above, below) = (row(y.first), row(y.second));
            for (x, out) in columns.iter().zip(out) {
                let across = |row: &[f32]| row[x.first] + (row[x.second] - row[x.first]) * x.share;
                let (above, below) = (across(above), across(below));
                *out = above + (below - above) * y.share;
            }
        }
    }
}

struct Sigmoid<'a> {
    input: &'a [f32],
    out: &'a mut [f32],
}

impl WithSimd for Sigmoid<'_> {
    type Output = ();

    /// The compiler makes vectors of it.
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.out.iter_mut().zip(self.input).for_each(|(out, v)| *out = 1.0 / (1.0 + exponential(-v)));
    }
}

/// e to the power of `x`, to two units of the last place: without branches, so that the compiler can make vectors of it.
#[inline(always)]
fn exponential(x: f32) -> f32 {
    /// Adding it rounds to whole numbers, which are then in the lowest bits.
    const ROUND: f32 = 12_582_912.0;
    /// The natural logarithm of 2 in two parts: the first has few bits, so its multiples are exact.
    const LN_2: [f32; 2] = [355.0 / 512.0, -2.121_944_4e-4];
    // Beyond these are 0 and numbers whose reciprocal is 0, as good as.
    let x = if x < -87.0 { -87.0 } else { x };
    let x = if x > 88.0 { 88.0 } else { x };
    let rounded = x * std::f32::consts::LOG2_E + ROUND;
    let power = rounded - ROUND;
    let rest = x - power * LN_2[0] - power * LN_2[1];
    // Taylor; the rest is at most half the logarithm of 2.
    let mut sum = 1.0 / 5040.0;
    for factor in [1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0] {
        sum = sum * rest + factor;
    }
    sum * f32::from_bits((rounded.to_bits() << 23).wrapping_add(0x3f80_0000))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponentials_are_those_of_the_standard_library() {
        for n in -8700..=8800 {
            let x = n as f32 * 0.01;
            let due = f64::from(x).exp();
            let share = (f64::from(exponential(x)) - due).abs() / due;
            assert!(share < 1e-6, "{x}: {share}");
        }
        assert!(exponential(-1e9) < 1e-37 && exponential(1e9) > 1e38 && exponential(f32::NAN).is_nan());
    }

    #[test]
    fn a_pool_sees_its_window_and_no_padding() {
        let window = Window { size: [3, 2], strides: [2, 2], dilations: [1, 1], pads: [[1, 1], [0, 1]] };
        let input: Vec<f32> = (0..15).map(|n| -((n * 7 % 15) as f32)).collect();
        let sizes = [window.outputs(0, 3), window.outputs(1, 5)].map(|size| size.unwrap_or(0));
        assert_eq!(sizes, [2, 3]);
        let mut out = [0.0; 6];
        max_pool(&window, [3, 5], sizes, &input, &mut out);
        let due = |rows: std::ops::Range<usize>, columns: std::ops::Range<usize>| {
            rows.flat_map(|y| columns.clone().map(move |x| (y, x)))
                .map(|(y, x)| input[y * 5 + x])
                .fold(f32::NEG_INFINITY, f32::max)
        };
        let rows = [0..2, 1..3];
        let columns = [0..2, 2..4, 4..5];
        for (n, out) in out.iter().enumerate() {
            assert_eq!(*out, due(rows[n / 3].clone(), columns[n % 3].clone()), "window {n}");
        }
    }
}
