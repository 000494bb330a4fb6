//! Huffman tables of a JPEG (ITU-T T.81, annexes C and F), made for reading on without keeping the coefficients.

use super::{Error, invalid};

/// Bits that one look-up sees.
const SEEN: u32 = 12;
/// A coefficient of more bits is looked at alone: it may be larger than a picture allows.
const SMALL_BITS: u32 = 5;

/// Codes and their symbols, as they stand in the file.
#[derive(Clone)]
pub(super) struct Codes {
    /// Codes of 1 to 16 bits.
    counts: [u8; 16],
    symbols: Vec<u8>,
    /// For each length: the first 16 bits that are larger than any code so far, and what to add to a code for its symbol's place.
    ends: [(u32, i32); 16],
}

impl Codes {
    /// From the 16 counts and the symbols of a DHT segment.
    pub(super) fn new(counts: [u8; 16], symbols: &[u8]) -> Result<Self, Error> {
        let mut ends = [(0, 0); 16];
        let (mut code, mut place) = (0u32, 0u32);
        for (bits, (&count, end)) in (1u32..).zip(counts.iter().zip(&mut ends)) {
            let after = code + u32::from(count);
            if after > 1 << bits {
                return Err(invalid(format!(
                    "a Huffman table has {count} codes of {bits} bits, {} are left",
                    (1 << bits) - code
                )));
            }
            // At most 256 symbols: both fit.
            *end =
                (after << (16 - bits), i32::try_from(place).unwrap_or(0) - i32::try_from(code).unwrap_or(0));
            place += u32::from(count);
            code = after << 1;
        }
        if place as usize != symbols.len() || place > 256 {
            return Err(invalid(format!("a Huffman table has {place} codes for {} symbols", symbols.len())));
        }
        Ok(Self { counts, symbols: symbols.to_vec(), ends })
    }

    /// The symbol at the top of `bits` and its code's length; none if there is no such code.
    #[cold]
    pub(super) fn symbol(&self, bits: u64) -> Option<(u8, u32)> {
        let top = (bits >> 48) as u32;
        let (length, (_, offset)) = (1u32..).zip(&self.ends).find(|(_, (end, _))| top < *end)?;
        let place = i64::from(top >> (16 - length)) + i64::from(*offset);
        Some((*self.symbols.get(usize::try_from(place).ok()?)?, length))
    }

    /// All codes: their bits, how many, symbol.
    fn all(&self) -> impl Iterator<Item = (u32, u32, u8)> + '_ {
        let mut symbols = self.symbols.iter();
        (1u32..).zip(self.counts.iter().zip(&self.ends)).flat_map(move |(length, (&count, (end, _)))| {
            let first = (end >> (16 - length)) - u32::from(count);
            let some: Vec<_> = (first..)
                .zip(symbols.by_ref().take(usize::from(count)))
                .map(|(c, s)| (c, length, *s))
                .collect();
            some
        })
    }

    /// As a DHT segment has it, without the byte that names the table.
    pub(super) fn bytes(&self) -> impl Iterator<Item = u8> + '_ {
        self.counts.iter().chain(&self.symbols).copied()
    }
}

/// What the next bits of a block mean, in a word: 4 bits for how many they are, above them how many coefficients they pass,
/// those of value zero too; [`END`] if the block ends with them, [`ASIDE`] alone if a table does not tell.
#[derive(Clone, Copy)]
pub(super) struct Step(u16);

/// Passed where a block ends early.
pub(super) const END: usize = 128;
/// Passed where a code or its value is not seen whole, or is large, or does not exist.
pub(super) const ASIDE: usize = 64;

/// Sixteen more are less than [`ASIDE`].
const MOST_PASSED: usize = ASIDE - 17;

impl Step {
    const ASIDE: Self = Self((ASIDE as u16) << 4);

    const fn new(bits: u32, passed: usize) -> Self {
        Self((passed << 4) as u16 | bits as u16)
    }

    #[inline]
    pub(super) const fn bits(self) -> u32 {
        self.0 as u32 & 15
    }

    #[inline]
    pub(super) const fn passed(self) -> usize {
        self.0 as usize >> 4
    }
}

/// Steps through the coefficients behind the first, several codes a look-up.
pub(super) struct Steps {
    pub(super) codes: Codes,
    one: Box<[Step; 1 << SEEN]>,
    several: Box<[Step; 1 << SEEN]>,
}

impl Steps {
    pub(super) fn new(codes: Codes) -> Self {
        let mut one = Box::new([Step::ASIDE; 1 << SEEN]);
        for (code, length, symbol) in codes.all().filter(|(_, length, _)| *length <= SEEN) {
            let (run, size) = (usize::from(symbol >> 4), u32::from(symbol & 15));
            let step = match (run, size) {
                (0, 0) => Step::new(length, END),
                (15, 0) => Step::new(length, 16),
                (_, 1..=SMALL_BITS) if length + size <= SEEN => Step::new(length + size, run + 1),
                _ => continue,
            };
            let first = (code << (SEEN - length)) as usize;
            one[first..first + (1 << (SEEN - length))].fill(step);
        }
        let mut many = one.clone();
        for (seen, step) in many.iter_mut().enumerate() {
            *step = several(&one, seen);
        }
        Self { codes, one, several: many }
    }

    /// One code.
    #[inline]
    pub(super) fn one(&self, bits: u64) -> Step {
        self.one[(bits >> (64 - SEEN)) as usize]
    }

    /// One code or several.
    #[inline]
    pub(super) fn several(&self, bits: u64) -> Step {
        self.several[(bits >> (64 - SEEN)) as usize]
    }
}

/// As many codes as are seen whole.
fn several(one: &[Step; 1 << SEEN], seen: usize) -> Step {
    let mut step = one[seen];
    // Of passed coefficients no more than the word can tell from an end.
    while step.passed() <= MOST_PASSED {
        let next = one[(seen << step.bits()) & ((1 << SEEN) - 1)];
        let bits = step.bits() + next.bits();
        if next.passed() == ASIDE || bits > SEEN {
            break;
        }
        step = Step::new(bits, step.passed() + next.passed());
    }
    step
}

/// Sizes of the changes of a level: one look-up for all but the rarest.
pub(super) struct Sizes {
    codes: Codes,
    /// By the next [`SIZE_SEEN`] bits: symbol, length of the code; 0: longer.
    seen: Vec<(u8, u8)>,
}

const SIZE_SEEN: u32 = 9;

impl Sizes {
    pub(super) fn new(codes: Codes) -> Self {
        let mut seen = vec![(0, 0); 1 << SIZE_SEEN];
        for (code, length, symbol) in codes.all().filter(|(_, length, _)| *length <= SIZE_SEEN) {
            let first = (code << (SIZE_SEEN - length)) as usize;
            seen[first..first + (1 << (SIZE_SEEN - length))].fill((symbol, length as u8));
        }
        Self { codes, seen }
    }

    /// See [`Codes::symbol`].
    #[inline]
    pub(super) fn symbol(&self, bits: u64) -> Option<(u8, u32)> {
        match self.seen.get((bits >> (64 - SIZE_SEEN)) as usize) {
            Some((symbol, length)) if *length > 0 => Some((*symbol, u32::from(*length))),
            _ => self.codes.symbol(bits),
        }
    }
}

/// The tables of T.81's annex K that MJPEG means where it has none: (class and number, counts, symbols).
pub(super) fn standard() -> Result<[(u8, Codes); 4], Error> {
    let chroma_dc = [0, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0];
    let luma_dc = [0, 1, 5, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0];
    let dc: Vec<u8> = (0..12).collect();
    Ok([
        (0x00, Codes::new(luma_dc, &dc)?),
        (0x10, Codes::new(LUMA_AC_COUNTS, &LUMA_AC)?),
        (0x01, Codes::new(chroma_dc, &dc)?),
        (0x11, Codes::new(CHROMA_AC_COUNTS, &CHROMA_AC)?),
    ])
}

const LUMA_AC_COUNTS: [u8; 16] = [0, 2, 1, 3, 3, 2, 4, 3, 5, 5, 4, 4, 0, 0, 1, 125];
#[rustfmt::skip]
const LUMA_AC: [u8; 162] = [
    0x01, 0x02, 0x03, 0x00, 0x04, 0x11, 0x05, 0x12, 0x21, 0x31, 0x41, 0x06, 0x13, 0x51, 0x61, 0x07, 0x22,
    0x71, 0x14, 0x32, 0x81, 0x91, 0xa1, 0x08, 0x23, 0x42, 0xb1, 0xc1, 0x15, 0x52, 0xd1, 0xf0, 0x24, 0x33,
    0x62, 0x72, 0x82, 0x09, 0x0a, 0x16, 0x17, 0x18, 0x19, 0x1a, 0x25, 0x26, 0x27, 0x28, 0x29, 0x2a, 0x34,
    0x35, 0x36, 0x37, 0x38, 0x39, 0x3a, 0x43, 0x44, 0x45, 0x46, 0x47, 0x48, 0x49, 0x4a, 0x53, 0x54, 0x55,
    0x56, 0x57, 0x58, 0x59, 0x5a, 0x63, 0x64, 0x65, 0x66, 0x67, 0x68, 0x69, 0x6a, 0x73, 0x74, 0x75, 0x76,
    0x77, 0x78, 0x79, 0x7a, 0x83, 0x84, 0x85, 0x86, 0x87, 0x88, 0x89, 0x8a, 0x92, 0x93, 0x94, 0x95, 0x96,
    0x97, 0x98, 0x99, 0x9a, 0xa2, 0xa3, 0xa4, 0xa5, 0xa6, 0xa7, 0xa8, 0xa9, 0xaa, 0xb2, 0xb3, 0xb4, 0xb5,
    0xb6, 0xb7, 0xb8, 0xb9, 0xba, 0xc2, 0xc3, 0xc4, 0xc5, 0xc6, 0xc7, 0xc8, 0xc9, 0xca, 0xd2, 0xd3, 0xd4,
    0xd5, 0xd6, 0xd7, 0xd8, 0xd9, 0xda, 0xe1, 0xe2, 0xe3, 0xe4, 0xe5, 0xe6, 0xe7, 0xe8, 0xe9, 0xea, 0xf1,
    0xf2, 0xf3, 0xf4, 0xf5, 0xf6, 0xf7, 0xf8, 0xf9, 0xfa,
];
const CHROMA_AC_COUNTS: [u8; 16] = [0, 2, 1, 2, 4, 4, 3, 4, 7, 5, 4, 4, 0, 1, 2, 119];
#[rustfmt::skip]
const CHROMA_AC: [u8; 162] = [
    0x00, 0x01, 0x02, 0x03, 0x11, 0x04, 0x05, 0x21, 0x31, 0x06, 0x12, 0x41, 0x51, 0x07, 0x61, 0x71, 0x13,
    0x22, 0x32, 0x81, 0x08, 0x14, 0x42, 0x91, 0xa1, 0xb1, 0xc1, 0x09, 0x23, 0x33, 0x52, 0xf0, 0x15, 0x62,
    0x72, 0xd1, 0x0a, 0x16, 0x24, 0x34, 0xe1, 0x25, 0xf1, 0x17, 0x18, 0x19, 0x1a, 0x26, 0x27, 0x28, 0x29,
    0x2a, 0x35, 0x36, 0x37, 0x38, 0x39, 0x3a, 0x43, 0x44, 0x45, 0x46, 0x47, 0x48, 0x49, 0x4a, 0x53, 0x54,
    0x55, 0x56, 0x57, 0x58, 0x59, 0x5a, 0x63, 0x64, 0x65, 0x66, 0x67, 0x68, 0x69, 0x6a, 0x73, 0x74, 0x75,
    0x76, 0x77, 0x78, 0x79, 0x7a, 0x82, 0x83, 0x84, 0x85, 0x86, 0x87, 0x88, 0x89, 0x8a, 0x92, 0x93, 0x94,
    0x95, 0x96, 0x97, 0x98, 0x99, 0x9a, 0xa2, 0xa3, 0xa4, 0xa5, 0xa6, 0xa7, 0xa8, 0xa9, 0xaa, 0xb2, 0xb3,
    0xb4, 0xb5, 0xb6, 0xb7, 0xb8, 0xb9, 0xba, 0xc2, 0xc3, 0xc4, 0xc5, 0xc6, 0xc7, 0xc8, 0xc9, 0xca, 0xd2,
    0xd3, 0xd4, 0xd5, 0xd6, 0xd7, 0xd8, 0xd9, 0xda, 0xe2, 0xe3, 0xe4, 0xe5, 0xe6, 0xe7, 0xe8, 0xe9, 0xea,
    0xf2, 0xf3, 0xf4, 0xf5, 0xf6, 0xf7, 0xf8, 0xf9, 0xfa,
];
