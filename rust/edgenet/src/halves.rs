//! Weights as they lie in the program: the ONNX files of `models/` with their large arrays of floats in 16 bits, which halves the program.
//! The build script packs, the library unpacks into a file again, so both runtimes see the same weights. Rounding to 11 bits moves
//! the maps by less than training's own noise: 0.003 at most, 1e-5 in the mean.
//!
//! Packed: so many bytes of the file, so many floats of 16 bits, and again; each after its count in 32 bits, all little-endian.
#![allow(dead_code)] // the build script has one half of it, the library the other

/// Arrays of fewer bytes stay as they are: coordinates and biases are among them, and there is nothing to gain.
const LEAST: usize = 4096;

/// The file with its large arrays of floats in 16 bits.
pub(crate) fn packed(file: &[u8]) -> Option<Vec<u8>> {
    let mut places = Vec::new();
    for graph in fields(file, 0..file.len())?.into_iter().filter(|field| field.number == 7) {
        for array in fields(file, graph.range)?.into_iter().filter(|field| field.number == 5) {
            let parts = fields(file, array.range)?;
            let is_float = parts.iter().any(|part| part.number == 2 && part.value == 1);
            let values = parts.into_iter().find(|part| part.number == 9 && part.range.len() >= LEAST);
            places.extend(values.filter(|_| is_float).map(|values| values.range));
        }
    }
    let mut packed = Vec::new();
    let mut at = 0;
    for place in places {
        push_len(&mut packed, place.start - at);
        packed.extend(&file[at..place.start]);
        push_len(&mut packed, place.len() / 4);
        for bytes in file[place.clone()].as_chunks().0 {
            packed.extend(half_of(f32::from_le_bytes(*bytes))?.to_le_bytes());
        }
        at = place.end;
    }
    push_len(&mut packed, file.len() - at);
    packed.extend(&file[at..]);
    push_len(&mut packed, 0);
    Some(packed)
}

/// The file again, with rounded weights. Ends where the packed one is cut off.
pub(crate) fn unpacked(mut packed: &[u8]) -> Vec<u8> {
    let mut file = Vec::with_capacity(2 * packed.len());
    let mut next = |of: usize| -> Option<&[u8]> {
        let (len, rest) = packed.split_first_chunk()?;
        let (part, rest) = rest.split_at_checked(u32::from_le_bytes(*len) as usize * of)?;
        packed = rest;
        Some(part)
    };
    while let Some(bytes) = next(1) {
        file.extend(bytes);
        let halves = next(2).unwrap_or_default();
        file.extend(halves.as_chunks().0.iter().flat_map(|b| float_of(u16::from_le_bytes(*b)).to_le_bytes()));
    }
    file
}

fn push_len(to: &mut Vec<u8>, len: usize) {
    to.extend(u32::try_from(len).expect("no file of ours is that large").to_le_bytes());
}

/// A field of a protobuf message: a number's value, or where its bytes are.
struct Field {
    number: u64,
    value: u64,
    range: std::ops::Range<usize>,
}

fn fields(file: &[u8], message: std::ops::Range<usize>) -> Option<Vec<Field>> {
    let (mut at, end) = (message.start, message.end);
    let mut fields = Vec::new();
    let number = |at: &mut usize| {
        let mut value = 0u64;
        for shift in (0..63).step_by(7) {
            let byte = *file.get(*at)?;
            *at += 1;
            value |= u64::from(byte & 127) << shift;
            if byte < 128 {
                return Some(value);
            }
        }
        None
    };
    while at < end {
        let key = number(&mut at)?;
        let (value, len) = match key & 7 {
            0 => (number(&mut at)?, 0),
            1 => (0, 8),
            2 => (0, usize::try_from(number(&mut at)?).ok()?),
            5 => (0, 4),
            _ => return None,
        };
        fields.push(Field { number: key >> 3, value, range: at..at + len });
        at += len;
    }
    (at == end).then_some(fields)
}

/// Rounded to the nearest float of 16 bits, to even; nothing if it is too large for one.
fn half_of(value: f32) -> Option<u16> {
    let size = value.abs().to_bits();
    let half = if value.abs() < 1.0 / 16384.0 {
        // A multiple of 2^-24; 1024 of them are the smallest with an exponent of its own.
        (value.abs() * 16_777_216.0).round_ties_even() as u32
    } else if value.abs() < 65_520.0 {
        ((size + 0xfff + ((size >> 13) & 1)) >> 13) - (112 << 10)
    } else {
        return None;
    };
    u16::try_from(half | (value.to_bits() >> 16 & 0x8000)).ok()
}

fn float_of(half: u16) -> f32 {
    let size = u32::from(half & 0x7fff);
    let value =
        if size < 1024 { size as f32 / 16_777_216.0 } else { f32::from_bits((size << 13) + (112 << 23)) };
    if half & 0x8000 == 0 { value } else { -value }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)] // the helpers of tests are tests
    use super::*;

    #[test]
    fn every_half_is_itself_and_others_go_to_the_nearest() {
        for half in (0..0x7c00).chain(0x8000..0xfc00) {
            assert_eq!(half_of(float_of(half)), Some(half), "{}", float_of(half));
        }
        for half in 0..0x7bff {
            let (low, high) = (float_of(half), float_of(half + 1));
            assert!(low < high);
            let (below, above) = (low + (high - low) * 0.49, low + (high - low) * 0.51);
            assert_eq!([half_of(below), half_of(above)], [Some(half), Some(half + 1)], "{low} {high}");
        }
        assert_eq!([half_of(65_519.0), half_of(65_520.0), half_of(f32::NAN)], [Some(0x7bff), None, None]);
    }

    #[test]
    fn a_file_comes_back_with_its_weights_rounded() {
        let file = include_bytes!("../models/lines.onnx");
        let packed = packed(file).unwrap();
        assert!(packed.len() * 5 < file.len() * 3, "{} of {}", packed.len(), file.len());
        let again = unpacked(&packed);
        assert_eq!(again.len(), file.len());
        let changed = again.iter().zip(file).filter(|(a, b)| a != b).count();
        assert!(changed > file.len() / 4, "{changed}");
        assert_eq!(unpacked(&super::packed(&again).unwrap()), again, "what is rounded stays");
        for end in [0, 1, 5, 100, packed.len() / 2] {
            assert!(unpacked(&packed[..end]).len() <= file.len());
        }
    }
}
