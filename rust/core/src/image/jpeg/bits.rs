//! Bits of a JPEG's data, read where they stand: no copy is made.

/// Reads bits from the highest down, up to the next marker; zeros follow.
#[derive(Clone, Copy)]
pub(super) struct Bits<'a> {
    file: &'a [u8],
    /// The next byte that is not in `seen`.
    at: usize,
    /// The next bits, from the top.
    pub(super) seen: u64,
    /// How many of them count.
    count: u32,
    /// Zeros that were added behind the data, in bits.
    added: u32,
}

/// What ends a part of the data.
pub(super) enum Mark {
    /// A marker, and the place behind it.
    At(u8, usize),
    /// The end of the file.
    Nothing,
}

impl<'a> Bits<'a> {
    /// From a place on.
    pub(super) const fn new(file: &'a [u8], at: usize) -> Self {
        Self { file, at, seen: 0, count: 0, added: 0 }
    }

    /// Sees to it that the next 56 bits are in `seen`.
    #[inline]
    pub(super) fn fill(&mut self) {
        let next = self
            .file
            .get(self.at..)
            .and_then(<[u8]>::first_chunk)
            .map_or(u64::MAX, |b| u64::from_be_bytes(*b));
        if has_ff(next) {
            *self = self.filled_bytewise();
            return;
        }
        self.seen |= next >> self.count;
        self.at += (63 - self.count as usize) >> 3;
        self.count |= 56;
    }

    /// The same where the next bytes have an ff, or are the last.
    #[cold]
    fn filled_bytewise(mut self) -> Self {
        // Bits that were filled in but do not count come again.
        self.seen &= !u64::MAX.unbounded_shr(self.count);
        while self.count <= 56 {
            let byte = match self.file.get(self.at..) {
                Some([0xff, 0, ..]) => {
                    self.at += 2;
                    0xff
                }
                None | Some([] | [0xff, ..]) => {
                    self.added += 8;
                    0
                }
                Some([byte, ..]) => {
                    self.at += 1;
                    *byte
                }
            };
            self.seen |= (u64::from(byte) << 56) >> self.count;
            self.count += 8;
        }
        self
    }

    /// Goes on by at most as many bits as were filled in.
    #[inline]
    pub(super) fn skip(&mut self, bits: u32) {
        self.seen = self.seen.unbounded_shl(bits);
        self.count = self.count.wrapping_sub(bits);
    }

    /// The next bits as a value of this size (T.81, F.2.2.1): those that begin with 0 are negative.
    #[inline]
    pub(super) fn value(&mut self, size: u32) -> i32 {
        // Without a branch: signs are as good as random.
        let bits = (self.seen >> 1 >> (63 - size)) as i32;
        let negative = !((self.seen as i64) >> 63) as i32;
        self.skip(size);
        bits + (negative & (1 - (1 << size)))
    }

    /// The place of the next bit's byte; some bytes off near an ff.
    #[inline]
    pub(super) fn place(&self) -> usize {
        self.at.saturating_sub((self.count.saturating_sub(self.added) / 8) as usize)
    }

    /// More was read than there is.
    #[inline]
    pub(super) fn is_beyond(&self) -> bool {
        self.added > self.count
    }

    /// Goes on to the marker. Returns how many whole bytes stand before it, 0 if they are but padding.
    pub(super) fn finish(&mut self) -> usize {
        self.fill();
        self.skip(self.count % 8);
        let (mut bytes, mut zeros, mut ones) = (0, true, true);
        while self.count > self.added {
            let byte = self.seen >> 56;
            zeros &= byte == 0;
            ones &= byte == 0xff;
            bytes += 1;
            self.skip(8);
            self.fill();
        }
        if zeros || ones { 0 } else { bytes }
    }

    /// After `finish`: what stands behind the data, and where.
    pub(super) fn mark(&self) -> (usize, Mark) {
        let rest = self.file.get(self.at..).unwrap_or_default();
        // Any number of ff may stand before a marker.
        let fill = rest.iter().take_while(|byte| **byte == 0xff).count();
        (self.at, rest.get(fill).map_or(Mark::Nothing, |marker| Mark::At(*marker, self.at + fill + 1)))
    }
}

/// Whether one of the eight bytes is ff.
#[inline]
const fn has_ff(bytes: u64) -> bool {
    const LOW: u64 = 0x0101_0101_0101_0101;
    // A byte that is 0 in `!bytes` borrows from its highest bit.
    (!bytes).wrapping_sub(LOW) & bytes & (LOW << 7) != 0
}

/// Where the next run of 16 equal bytes or more begins and ends, some bytes within it.
pub(super) fn next_run(file: &[u8], from: usize) -> Option<[usize; 2]> {
    const WORD: usize = 8;
    let equal = |bytes: &[u8]| {
        bytes
            .first_chunk::<WORD>()
            .is_some_and(|b| u64::from_ne_bytes(*b).rotate_left(8) == u64::from_ne_bytes(*b))
    };
    let rest = file.get(from..)?;
    let (mut words, mut at) = (rest.chunks_exact(WORD), from);
    while let Some(word) = words.next() {
        if equal(word) {
            let more = words.clone().take_while(|other| *other == word).count();
            if more > 0 {
                return Some([at, at + (more + 1) * WORD]);
            }
        }
        at += WORD;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_ff_is_seen_anywhere() {
        for place in 0..8 {
            assert!(has_ff(0xff << (8 * place)));
            assert!(has_ff(0x0180_fe7f_0001_80fe | 0xff << (8 * place)));
        }
        assert!(!has_ff(0) && !has_ff(0x0180_fe7f_0001_80fe) && !has_ff(0xfefe_fefe_fefe_fefe));
    }

    #[test]
    fn bits_are_those_of_the_file_without_stuffing() {
        let file = [
            0x12, 0xff, 0x00, 0x34, 0x56, 0x78, 0x9a, 0xbc, 0xde, 0xf0, 0x11, 0xff, 0x00, 0x22, 0xff, 0xd9,
            0x77,
        ];
        let plain: [u8; 12] = [0x12, 0xff, 0x34, 0x56, 0x78, 0x9a, 0xbc, 0xde, 0xf0, 0x11, 0xff, 0x22];
        for step in 1..=13 {
            let mut bits = Bits::new(&file, 0);
            let mut read = 0;
            while read + step <= plain.len() * 8 {
                bits.fill();
                for i in 0..step {
                    let expected = plain[(read + i) / 8] >> (7 - (read + i) % 8) & 1;
                    assert_eq!(
                        bits.seen >> (63 - i) & 1,
                        u64::from(expected),
                        "bit {} in steps of {step}",
                        read + i
                    );
                }
                bits.skip(step as u32);
                read += step;
                assert!(!bits.is_beyond());
            }
            let left = (plain.len() * 8 - read) / 8;
            let mut end = bits;
            assert_eq!(end.finish(), if left == 0 { 0 } else { left });
            assert!(matches!(end.mark(), (14, Mark::At(0xd9, 16))));
            bits.fill();
            bits.skip(14);
            assert!(bits.is_beyond());
        }
    }

    #[test]
    fn runs_are_found_wherever_they_stand() {
        let mut bytes: Vec<u8> = (0..200).map(|i| (i * 37 % 251) as u8).collect();
        assert_eq!(next_run(&bytes, 0), None);
        bytes[70..101].fill(9);
        let [from, to] = next_run(&bytes, 3).unwrap();
        assert!((70..78).contains(&from) && (94..=101).contains(&to), "{from} {to}");
        assert_eq!(next_run(&bytes, to), None);
    }
}
