//! Convolutions. Of a strip of rows, the input is laid out so that what one weight is multiplied with is a run of memory: padded, and for
//! a stride above one split into its phases. The convolution is then a sum of shifted runs, each times a weight, and a tile of
//! a few channels times a few vectors of pixels stays in registers for the whole sum. Strips stay in the second cache.
//!
//! The crate `pulp` has the vectors: it asks the processor at run time (AVX-512, AVX2; NEON) and keeps its `unsafe` to itself.

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// Floats of a strip's input: with its output it stays in the second cache, which has 256 KB on small phones.
const STRIP: usize = 32 * 1024;
/// Vectors of pixels in a tile.
const VECTORS: usize = 3;
/// Floats that a tile may read and write behind its strip: the widest vector has 16.
const SLACK: usize = 16 * VECTORS;

/// Where a convolution looks, rows first.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Window {
    /// Weights in each direction.
    pub size: [usize; 2],
    /// Step from one output to the next.
    pub strides: [usize; 2],
    /// Step from one weight to the next.
    pub dilations: [usize; 2],
    /// Zeros before the first and behind the last.
    pub pads: [[usize; 2]; 2],
}

impl Window {
    /// Rows or columns of the output for so many of the input.
    pub fn outputs(&self, axis: usize, inputs: usize) -> Option<usize> {
        let padded = inputs.checked_add(self.pads[axis][0])?.checked_add(self.pads[axis][1])?;
        let reach = self.size[axis].checked_sub(1)?.checked_mul(self.dilations[axis])?.checked_add(1)?;
        padded.checked_sub(reach)?.checked_div(self.strides[axis])?.checked_add(1)
    }

    /// Floats of the input that one row of the output is made from; nothing if they are too many.
    pub fn strip_len(&self, channels: usize, columns: usize) -> Option<usize> {
        let extra = [0, 1].map(|axis| (self.size[axis] - 1) * self.dilations[axis] / self.strides[axis]);
        let phases = (self.strides[0] * self.strides[1]).min(self.size[0] * self.size[1]);
        super::len_of(&[channels, phases, extra[0] + 1, columns + extra[1]])
    }

    /// Whether an output sees one pixel, its own.
    fn is_point(&self) -> bool {
        self.size == [1, 1] && self.strides == [1, 1] && self.pads == [[0, 0]; 2]
    }
}

/// What is done to a sum before it is stored.
#[derive(Clone, Copy)]
pub(crate) struct Epilogue<'a> {
    /// Added: a map of the same size, or of half of it in both directions, each of whose values counts for four.
    pub add: Option<AddedMap<'a>>,
    /// Negative ones become 0.
    pub relu: bool,
}

/// A map that is added.
#[derive(Clone, Copy)]
pub(crate) struct AddedMap<'a> {
    pub values: &'a [f32],
    pub halved: bool,
}

/// A convolution of an input of fixed size.
pub(crate) struct Conv {
    window: Window,
    /// Channels, rows, columns.
    input: [usize; 3],
    output: [usize; 3],
    /// By row and column: phases of the stride that some weight needs.
    phases: Vec<[usize; 2]>,
    /// A row of the strip has this many columns more than the output, a phase this many rows.
    extra: [usize; 2],
    blocks: Vec<Block>,
}

/// Channels of the output that are worked out together.
struct Block {
    channels: usize,
    /// For each weight of a channel as many as `bias` has, side by side.
    weights: Vec<f32>,
    /// 8 or 4; those above `channels` are 0.
    bias: Vec<f32>,
}

/// Memory of one thread, kept from call to call.
#[derive(Default)]
pub(crate) struct Scratch {
    strip: Vec<f32>,
    sums: Vec<f32>,
    offsets: Vec<usize>,
}

impl Conv {
    /// From weights in ONNX's order: output channel, input channel, row, column. The caller has checked all sizes.
    pub fn new(window: Window, input: [usize; 3], output: [usize; 3], weights: &[f32], bias: &[f32]) -> Self {
        let taps = window.size[0] * window.size[1] * input[0];
        let most = Arch::new().dispatch(Registers);
        let mut blocks = Vec::new();
        let mut first = 0;
        while first < output[0] {
            let channels = (output[0] - first).min(most);
            let width = if channels > 4 { 8 } else { 4 };
            let mut packed = vec![0.0; taps * width];
            let mut packed_bias = vec![0.0; width];
            for channel in 0..channels {
                packed_bias[channel] = bias.get(first + channel).copied().unwrap_or(0.0);
                let own = &weights[(first + channel) * taps..][..taps];
                own.iter().zip(packed.chunks_exact_mut(width)).for_each(|(w, to)| to[channel] = *w);
            }
            blocks.push(Block { channels, weights: packed, bias: packed_bias });
            first += channels;
        }
        let mut phases = Vec::new();
        let mut extra = [0, 0];
        for tap in taps_of(&window) {
            let phase = [tap[0] % window.strides[0], tap[1] % window.strides[1]];
            if !phases.contains(&phase) {
                phases.push(phase);
            }
            extra = [0, 1].map(|axis| extra[axis].max(tap[axis] / window.strides[axis]));
        }
        Self { window, input, output, phases, extra, blocks }
    }

    /// Values of the output.
    pub const fn output_len(&self) -> usize {
        self.output[0] * self.output[1] * self.output[2]
    }

    /// Fills the output, with as many threads as there is memory for.
    pub fn run(&self, input: &[f32], after: Epilogue<'_>, out: &mut [f32], scratch: &mut [Scratch]) {
        let [channels, rows, columns] = self.output;
        // A thread costs some microseconds to wake; less work than this is done before it comes.
        const LEAST: usize = 1 << 20;
        let work = self.output_len() * self.input[0] * self.window.size[0] * self.window.size[1];
        let parts = scratch.len().min(rows).min(work / LEAST + 1);
        let share = rows.div_ceil(parts);
        if parts < 2 {
            if let Some(scratch) = scratch.first_mut() {
                let planes = out.chunks_exact_mut(rows * columns).collect();
                Arch::new().dispatch(Rows { conv: self, input, after, first: 0, planes, scratch });
            }
            return;
        }
        let mut planes: Vec<Vec<&mut [f32]>> = (0..parts).map(|_| Vec::with_capacity(channels)).collect();
        for plane in out.chunks_exact_mut(rows * columns) {
            for (part, rows) in planes.iter_mut().zip(plane.chunks_mut(share * columns)) {
                part.push(rows);
            }
        }
        let parts = planes.into_par_iter().zip(scratch.par_iter_mut()).enumerate();
        parts.for_each(|(part, (planes, scratch))| {
            let first = part * share;
            Arch::new().dispatch(Rows { conv: self, input, after, first, planes, scratch });
        });
    }
}

/// Rows of all channels of the output, to be filled by one thread.
struct Rows<'a> {
    conv: &'a Conv,
    input: &'a [f32],
    after: Epilogue<'a>,
    /// The first of them.
    first: usize,
    planes: Vec<&'a mut [f32]>,
    scratch: &'a mut Scratch,
}

impl WithSimd for Rows<'_> {
    type Output = ();

    /// All that is called from here is compiled for the processor's vectors, so all of it is inlined.
    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let columns = self.conv.output[2];
        let rows = self.planes.first().map_or(0, |plane| plane.len() / columns);
        let row = (columns + self.conv.extra[1]) * self.conv.phases.len() * self.conv.input[0];
        let most = (STRIP / row.max(1)).saturating_sub(self.conv.extra[0]).max(1);
        // All strips alike, so that the last is not a remnant.
        let strips = rows.div_ceil(most);
        let mut done = 0;
        for strip in 0..strips {
            let here = (rows - done).div_ceil(strips - strip);
            self.strip(simd, done, here);
            done += here;
        }
    }
}

impl Rows<'_> {
    #[inline(always)]
    fn strip<S: Simd>(&mut self, simd: S, done: usize, rows: usize) {
        let Self { conv, input, after, first, planes, scratch } = self;
        let (columns, top) = (conv.output[2], *first + done);
        let width = columns + conv.extra[1];
        let len = rows * width;
        let stride = len + SLACK;
        let plane = conv.input[1] * conv.input[2];
        let Scratch { strip, sums, offsets } = &mut **scratch;
        offsets.clear();
        let source = if conv.window.is_point() && (top + rows) * columns + SLACK <= plane {
            offsets.extend((0..conv.input[0]).map(|channel| channel * plane + top * columns));
            *input
        } else {
            let phase_len = (rows + conv.extra[0]) * width;
            grow(strip, conv.input[0] * conv.phases.len() * phase_len + conv.extra[1] + SLACK);
            for channel in 0..conv.input[0] {
                for (number, phase) in conv.phases.iter().enumerate() {
                    let to = &mut strip[(channel * conv.phases.len() + number) * phase_len..][..phase_len];
                    conv.lay_out(&input[channel * plane..][..plane], *phase, top, to, width);
                }
                for tap in taps_of(&conv.window) {
                    let [sy, sx] = conv.window.strides;
                    let phase =
                        conv.phases.iter().position(|p| *p == [tap[0] % sy, tap[1] % sx]).unwrap_or(0);
                    let at = (channel * conv.phases.len() + phase) * phase_len;
                    offsets.push(at + tap[0] / sy * width + tap[1] / sx);
                }
            }
            &**strip
        };
        let mut channel = 0;
        for block in &conv.blocks {
            grow(sums, block.bias.len() * stride);
            for at in (0..len).step_by(VECTORS * S::F32_LANES) {
                let (source, sums) = (&source[at..], &mut sums[at..]);
                if block.bias.len() == 8 {
                    tile::<S, 8>(simd, source, offsets, block, sums, stride);
                } else {
                    tile::<S, 4>(simd, source, offsets, block, sums, stride);
                }
            }
            for own in 0..block.channels {
                let to = &mut planes[channel][done * columns..][..rows * columns];
                let sums = &sums[own * stride..][..len];
                for (row, (to, sums)) in to.chunks_exact_mut(columns).zip(sums.chunks(width)).enumerate() {
                    conv.finish(*after, [channel, top + row], &sums[..columns], to);
                }
                channel += 1;
            }
        }
    }
}

impl Conv {
    /// A phase of a channel's rows from `top` on.
    #[inline(always)]
    fn lay_out(&self, channel: &[f32], phase: [usize; 2], top: usize, to: &mut [f32], width: usize) {
        let [_, rows, columns] = self.input;
        let [[above, _], [left, _]] = self.window.pads;
        let [sy, sx] = self.window.strides;
        // Columns that are in the picture: x * sx + phase - left is one of its columns.
        let begin = left.saturating_sub(phase[1]).div_ceil(sx).min(width);
        let end = (columns + left).saturating_sub(phase[1]).div_ceil(sx).clamp(begin, width);
        for (y, to) in to.chunks_exact_mut(width).enumerate() {
            let from = ((top + y) * sy + phase[0]).checked_sub(above).filter(|y| *y < rows);
            let Some(from) = from else {
                to.fill(0.0);
                continue;
            };
            let from = &channel[from * columns..][..columns];
            to[..begin].fill(0.0);
            to[end..].fill(0.0);
            if begin < end {
                let from = &from[begin * sx + phase[1] - left..];
                match sx {
                    1 => to[begin..end].copy_from_slice(&from[..end - begin]),
                    2 => every_second(from, &mut to[begin..end]),
                    _ => to[begin..end].iter_mut().zip(from.iter().step_by(sx)).for_each(|(to, v)| *to = *v),
                }
            }
        }
    }

    /// A row of sums to a row of the output.
    #[inline(always)]
    fn finish(&self, after: Epilogue<'_>, [channel, row]: [usize; 2], sums: &[f32], to: &mut [f32]) {
        let [_, rows, columns] = self.output;
        let least = if after.relu { 0.0 } else { f32::NEG_INFINITY };
        // Not `max`: what is no number must stay so and be found at the end.
        let kept = |v: f32| if v < least { least } else { v };
        match after.add {
            None => to.iter_mut().zip(sums).for_each(|(to, sum)| *to = kept(*sum)),
            Some(AddedMap { values, halved: false }) => {
                let values = &values[(channel * rows + row) * columns..][..columns];
                to.iter_mut().zip(sums).zip(values).for_each(|((to, sum), v)| *to = kept(*sum + v));
            }
            Some(AddedMap { values, halved: true }) => {
                let values = &values[(channel * (rows / 2) + row / 2) * (columns / 2)..][..columns / 2];
                let pairs = to.as_chunks_mut::<2>().0.iter_mut().zip(sums.as_chunks::<2>().0);
                pairs.zip(values).for_each(|((to, sums), v)| *to = sums.map(|sum| kept(sum + v)));
            }
        }
    }
}

#[inline(always)]
fn every_second(from: &[f32], to: &mut [f32]) {
    let pairs = from.as_chunks::<2>().0;
    for (to, pair) in to.iter_mut().zip(pairs) {
        *to = pair[0];
    }
    if to.len() > pairs.len() {
        to[pairs.len()] = from[2 * pairs.len()];
    }
}

/// Row and column of each weight, from the first one.
fn taps_of(window: &Window) -> impl Iterator<Item = [usize; 2]> + '_ {
    let [rows, columns] = window.size;
    (0..rows * columns).map(move |n| [n / columns * window.dilations[0], n % columns * window.dilations[1]])
}

fn grow(memory: &mut Vec<f32>, len: usize) {
    if memory.len() < len {
        memory.resize(len, 0.0);
    }
}

/// How many channels a tile can have.
struct Registers;

impl WithSimd for Registers {
    type Output = usize;

    fn with_simd<S: Simd>(self, _: S) -> usize {
        if S::REGISTER_COUNT >= 32 { 8 } else { 4 }
    }
}

/// `C` channels of a few vectors of pixels.
#[inline(always)]
fn tile<S: Simd, const C: usize>(
    simd: S,
    source: &[f32],
    offsets: &[usize],
    block: &Block,
    sums: &mut [f32],
    stride: usize,
) {
    let mut tile = [[simd.splat_f32s(0.0); VECTORS]; C];
    for (row, bias) in tile.iter_mut().zip(&block.bias) {
        *row = [simd.splat_f32s(*bias); VECTORS];
    }
    for (weights, offset) in block.weights.as_chunks::<C>().0.iter().zip(offsets) {
        let values = S::as_simd_f32s(&source[*offset..][..VECTORS * S::F32_LANES]).0;
        let values: [S::f32s; VECTORS] = std::array::from_fn(|n| values[n]);
        for (row, weight) in tile.iter_mut().zip(weights) {
            let weight = simd.splat_f32s(*weight);
            for (sum, value) in row.iter_mut().zip(values) {
                *sum = simd.mul_add_e_f32s(weight, value, *sum);
            }
        }
    }
    for (channel, row) in tile.iter().enumerate() {
        let to = S::as_mut_simd_f32s(&mut sums[channel * stride..][..VECTORS * S::F32_LANES]).0;
        to.copy_from_slice(row);
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)] // the helpers of tests are tests
    use super::*;
    use proptest::prelude::*;
    use pulp::Scalar;

    /// The sum as it is written, in f64.
    fn naive(conv: &Conv, weights: &[f32], bias: &[f32], input: &[f32], after: Epilogue<'_>) -> Vec<f64> {
        let Window { size, strides, dilations, pads } = conv.window.clone();
        let ([channels, rows, columns], [outputs, out_rows, out_columns]) = (conv.input, conv.output);
        let mut out = Vec::new();
        for o in 0..outputs {
            for y in 0..out_rows {
                for x in 0..out_columns {
                    let mut sum = f64::from(bias[o]);
                    for c in 0..channels {
                        for ky in 0..size[0] {
                            for kx in 0..size[1] {
                                let row = (y * strides[0] + ky * dilations[0]).checked_sub(pads[0][0]);
                                let column = (x * strides[1] + kx * dilations[1]).checked_sub(pads[1][0]);
                                let (Some(row), Some(column)) = (row, column) else { continue };
                                if row < rows && column < columns {
                                    let weight = weights[((o * channels + c) * size[0] + ky) * size[1] + kx];
                                    sum += f64::from(weight)
                                        * f64::from(input[(c * rows + row) * columns + column]);
                                }
                            }
                        }
                    }
                    sum += match after.add {
                        None => 0.0,
                        Some(AddedMap { values, halved: false }) => f64::from(values[out.len()]),
                        Some(AddedMap { values, halved: true }) => {
                            f64::from(values[(o * (out_rows / 2) + y / 2) * (out_columns / 2) + x / 2])
                        }
                    };
                    out.push(if after.relu { sum.max(0.0) } else { sum });
                }
            }
        }
        out
    }

    /// Numbers between -1 and 1.
    fn numbers(count: usize, seed: usize) -> Vec<f32> {
        (0..count).map(|n| ((n * 7919 + seed * 104_729) % 2003) as f32 / 1001.5 - 1.0).collect()
    }

    fn scratch(threads: usize) -> Vec<Scratch> {
        (0..threads).map(|_| Scratch::default()).collect()
    }

    fn windows() -> impl Strategy<Value = Window> {
        let axis = || (1usize..=4, 1usize..=3, 1usize..=2, 0usize..=2, 0usize..=2);
        (axis(), axis()).prop_map(|(a, b)| Window {
            size: [a.0, b.0],
            strides: [a.1, b.1],
            dilations: [a.2, b.2],
            pads: [[a.3, a.4], [b.3, b.4]],
        })
    }

    proptest! {
        #[test]
        fn any_convolution_is_the_sum_as_it_is_written(
            window in windows(),
            input in (1usize..=9, 1usize..=24, 1usize..=70),
            outputs in 1usize..=19,
            (add, relu, seed) in (0usize..3, any::<bool>(), 0usize..1000),
        ) {
            let input_sizes: [usize; 3] = input.into();
            let sizes = [window.outputs(0, input.1), window.outputs(1, input.2)];
            let [Some(rows), Some(columns)] = sizes else { return Ok(()) };
            let output = [outputs, rows, columns];
            let weights = numbers(outputs * input.0 * window.size[0] * window.size[1], seed);
            let (bias, picture) = (numbers(outputs, seed + 1), numbers(input.0 * input.1 * input.2, seed + 2));
            let halved = add == 2 && rows % 2 == 0 && columns % 2 == 0;
            let values = numbers(outputs * rows * columns, seed + 3);
            let after = Epilogue { add: (add > 0).then_some(AddedMap { values: &values, halved }), relu };
            let conv = Conv::new(window, input_sizes, output, &weights, &bias);
            let due = naive(&conv, &weights, &bias, &picture, after);
            let mut out = vec![f32::NAN; conv.output_len()];
            conv.run(&picture, after, &mut out, &mut scratch(1));
            // Memory that another convolution used, and a processor without vectors.
            let mut used = Scratch { strip: vec![f32::NAN; 9], sums: vec![f32::NAN; 99], offsets: vec![7] };
            let mut plain = vec![f32::NAN; conv.output_len()];
            let planes = plain.chunks_exact_mut(rows * columns).collect();
            Rows { conv: &conv, input: &picture, after, first: 0, planes, scratch: &mut used }.with_simd(Scalar::new());
            for ((found, plain), due) in out.iter().zip(&plain).zip(&due) {
                prop_assert!((f64::from(*found) - due).abs() < 1e-4, "{found}, {due} is due");
                prop_assert!((f64::from(*plain) - due).abs() < 1e-4, "{plain}, {due} is due");
            }
        }
    }

    #[test]
    fn any_number_of_threads_gives_the_same_to_the_bit() {
        let window = Window { size: [3, 3], strides: [1, 1], dilations: [1, 1], pads: [[1, 1], [1, 1]] };
        for rows in [1, 7, 67] {
            let sizes = [17, rows, 129];
            let (weights, picture) = (numbers(20 * 17 * 9, 1), numbers(17 * rows * 129, 2));
            let conv = Conv::new(window.clone(), sizes, [20, rows, 129], &weights, &numbers(20, 3));
            let run = |threads| {
                let mut out = vec![f32::NAN; conv.output_len()];
                conv.run(&picture, Epilogue { add: None, relu: true }, &mut out, &mut scratch(threads));
                out
            };
            let one = run(1);
            assert!((2..9).all(|threads| run(threads) == one), "{rows} rows");
        }
    }

    #[test]
    fn what_is_no_number_is_not_hidden() {
        let window = Window { size: [1, 1], strides: [1, 1], dilations: [1, 1], pads: [[0, 0], [0, 0]] };
        let conv = Conv::new(window, [1, 1, 2], [1, 1, 2], &[1.0], &[0.0]);
        let mut out = [0.0; 2];
        conv.run(&[f32::NAN, -1.0], Epilogue { add: None, relu: true }, &mut out, &mut scratch(1));
        assert!(out[0].is_nan() && out[1] == 0.0, "{out:?}");
    }
}
