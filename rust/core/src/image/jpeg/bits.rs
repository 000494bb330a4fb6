//! Bits of a JPEG's data between two markers.

/// The bytes of a scan up to the next marker, without the zeros that are stuffed behind each ff.
pub(super) struct Part {
    /// Eight zeros follow: what is read beyond the end.
    bytes: Vec<u8>,
    /// Runs of equal bytes, as places in `bytes`: a picture has none.
    runs: Vec<[usize; 2]>,
}

/// What ends a part.
pub(super) enum Mark {
    /// A marker, and the place behind it.
    At(u8, usize),
    /// The end of the file.
    Nothing,
}

/// Bytes that are seen together when runs are looked for.
const WORD: usize = 8;

impl Part {
    /// With space for this many bytes of a file.
    pub(super) fn new(most: usize) -> Self {
        Self { bytes: Vec::with_capacity(most + WORD), runs: Vec::new() }
    }

    /// Takes the bytes from `at` to the next marker; returns that marker.
    pub(super) fn take(&mut self, file: &[u8], mut at: usize) -> Mark {
        self.bytes.clear();
        let mark = loop {
            let rest = file.get(at..).unwrap_or_default();
            let plain = plain(rest);
            self.bytes.extend_from_slice(&rest[..plain]);
            // Any number of ff may stand before a marker.
            let fill = rest[plain..].iter().take_while(|byte| **byte == 0xff).count();
            match rest.get(plain + fill) {
                Some(0) if fill == 1 => {
                    self.bytes.push(0xff);
                    at += plain + 2;
                }
                Some(&marker) => break Mark::At(marker, at + plain + fill + 1),
                None => break Mark::Nothing,
            }
        };
        self.find_runs();
        self.bytes.extend_from_slice(&[0; WORD]);
        mark
    }

    /// Two words of one and the same byte, or more.
    fn find_runs(&mut self) {
        self.runs.clear();
        let mut run = [0, 0];
        let mut last = None;
        for (i, word) in self.bytes.chunks_exact(WORD).enumerate() {
            let word = u64::from_ne_bytes(word.try_into().unwrap_or_default());
            if word != word.rotate_left(8) {
                last = None;
                continue;
            }
            if last != Some(word) {
                run = [i * WORD, 0];
                last = Some(word);
            }
            run[1] = (i + 1) * WORD;
            match self.runs.last_mut() {
                Some(known) if known[0] == run[0] => *known = run,
                _ => self.runs.push(run),
            }
        }
    }

    /// Bytes, without those that were added.
    pub(super) fn len(&self) -> usize {
        self.bytes.len().saturating_sub(WORD)
    }

    /// All bytes from a place on are padding.
    pub(super) fn only_padding_from(&self, at: usize) -> bool {
        let rest = self.bytes.get(at..self.len()).unwrap_or_default();
        rest.iter().all(|byte| *byte == 0) || rest.iter().all(|byte| *byte == 0xff)
    }

    pub(super) fn runs(&self) -> &[[usize; 2]] {
        &self.runs
    }

    pub(super) fn bits(&self) -> Bits<'_> {
        Bits { bytes: &self.bytes, at: 0, seen: 0, count: 0 }
    }
}

/// How many bytes come before the first ff.
fn plain(bytes: &[u8]) -> usize {
    let none = |some: &&[u8]| some.iter().fold(true, |none, byte| none & (*byte != 0xff));
    let blocks = bytes.chunks_exact(32).take_while(none).count() * 32;
    blocks + bytes[blocks..].iter().take_while(|byte| **byte != 0xff).count()
}

/// Reads bits from the highest down.
#[derive(Clone, Copy)]
pub(super) struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
    /// The next bits, from the top.
    pub(super) seen: u64,
    count: u32,
}

impl Bits<'_> {
    /// Sees to it that the next 56 bits are in `seen`; zeros follow the end.
    #[inline]
    pub(super) fn fill(&mut self) {
        let word =
            self.bytes.get(self.at..).and_then(<[u8]>::first_chunk).map_or(0, |b| u64::from_be_bytes(*b));
        self.seen |= word >> self.count;
        self.at += (63 - self.count as usize) >> 3;
        self.count |= 56;
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

    /// Bits read so far.
    #[inline]
    pub(super) fn read(&self) -> usize {
        (self.at * 8).wrapping_sub(self.count as usize)
    }
}
