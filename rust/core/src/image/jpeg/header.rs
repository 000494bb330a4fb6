//! What stands before a JPEG's data: sizes, tables, the order of its parts. Nothing here takes more memory than the file has bytes.

use super::huffman::{Codes, Sizes, Steps, standard};
use super::{Error, invalid};
use crate::image::size::check_size;

/// One of one or three colours.
pub(super) struct Component {
    id: u8,
    quantization: u8,
    /// Blocks in a unit of the scan.
    pub(super) across: usize,
    pub(super) down: usize,
    /// Steps of the coefficients, in the order of the data.
    pub(super) steps: [u16; 64],
    /// Numbers of the Huffman tables.
    pub(super) dc: usize,
    pub(super) ac: usize,
}

/// What the scan is made of.
pub(super) struct Header {
    pub(super) components: Vec<Component>,
    /// Units (MCU) across and down.
    pub(super) units: [usize; 2],
    /// Units between restart markers, 0: none.
    pub(super) restart: usize,
    /// Tables by number.
    pub(super) dc: [Option<Sizes>; 4],
    pub(super) ac: [Option<Steps>; 4],
    /// Where the scan's own header starts, and its data.
    pub(super) scan_header_at: usize,
    pub(super) data_at: usize,
    /// Tables that the file lacks: those of the standard, as a segment.
    pub(super) tables: Option<Vec<u8>>,
}

impl Header {
    /// Blocks of 8 x 8 samples in a unit of the scan.
    pub(super) fn blocks_in_unit(&self) -> usize {
        self.components.iter().map(|c| c.across * c.down).sum()
    }
}

/// What has been read so far.
#[derive(Default)]
struct Parts {
    size: Option<[usize; 2]>,
    components: Vec<Component>,
    quantization: [Option<[u16; 64]>; 4],
    codes: [[Option<Codes>; 4]; 2],
    restart: usize,
}

/// Reads on to the data of the first scan.
pub(super) fn read(bytes: &[u8]) -> Result<Header, Error> {
    if bytes.get(..2) != Some(&[0xff, 0xd8]) {
        return Err(invalid(if bytes.starts_with(b"\x89PNG") {
            "the frame is a PNG, a JPEG is needed"
        } else {
            "the frame is not a JPEG: it does not begin with ff d8"
        }));
    }
    let mut parts = Parts::default();
    let mut at = 2;
    loop {
        let found = bytes.get(at).copied();
        if found != Some(0xff) {
            return Err(match found {
                Some(byte) => {
                    invalid(format!("byte {at} of the frame is {byte:02x}, a marker begins with ff"))
                }
                None => invalid(format!("the frame ends after {} bytes, before its data", bytes.len())),
            });
        }
        // Any number of ff may stand before a marker.
        let fill = bytes[at..].iter().take_while(|byte| **byte == 0xff).count();
        let start = at + fill + 1;
        let marker = bytes.get(start - 1).copied().unwrap_or(0);
        let segment = segment(bytes, start).ok_or_else(|| {
            invalid(format!("the frame ends within its segment {marker:02x} at byte {at}, before its data"))
        })?;
        match marker {
            0xc0 | 0xc1 => parts.frame(segment)?,
            0xc2 | 0xca => {
                return Err(invalid(
                    "the JPEG is a progressive one, only baseline and extended ones are allowed",
                ));
            }
            0xc3 | 0xc5..=0xc7 | 0xc9 | 0xcb | 0xcd..=0xcf => {
                return Err(invalid(format!(
                    "the JPEG is of kind {marker:02x}, only c0 (baseline) and c1 (extended) are allowed"
                )));
            }
            0xc4 => parts.huffman(segment)?,
            0xdb => parts.quantization(segment)?,
            0xdd => match *segment {
                [high, low] => parts.restart = usize::from(u16::from_be_bytes([high, low])),
                _ => return Err(short("restart interval", segment)),
            },
            0xda => return parts.scan(segment, start - 2, start + 2 + segment.len()),
            0xe0..=0xef | 0xfe => {}
            _ => {
                return Err(invalid(format!(
                    "marker {marker:02x} at byte {at} may not stand before the data of a JPEG"
                )));
            }
        }
        at = start + 2 + segment.len();
    }
}

/// What a segment holds: its first two bytes are its length.
fn segment(bytes: &[u8], start: usize) -> Option<&[u8]> {
    let length = usize::from(u16::from_be_bytes(*bytes.get(start..)?.first_chunk()?));
    bytes.get(start + 2..(start + length).max(start + 2)).filter(|_| length >= 2)
}

fn short(what: &str, segment: &[u8]) -> Error {
    invalid(format!("the JPEG's {what} has a wrong length of {} bytes", segment.len()))
}

impl Parts {
    fn frame(&mut self, segment: &[u8]) -> Result<(), Error> {
        let [bits, h1, h0, w1, w0, count, ref colours @ ..] = *segment else {
            return Err(short("frame header", segment));
        };
        let [width, height] = [[w1, w0], [h1, h0]].map(|side| usize::from(u16::from_be_bytes(side)));
        if self.size.is_some() {
            return Err(invalid("the JPEG has two frame headers, one is allowed"));
        }
        if bits != 8 {
            return Err(invalid(format!("the JPEG has samples of {bits} bits, 8 are allowed")));
        }
        check_size(width, height)?;
        if count != 1 && count != 3 {
            return Err(invalid(format!("the JPEG has {count} colours, 1 or 3 are allowed")));
        }
        if colours.len() != usize::from(count) * 3 {
            return Err(short("frame header", segment));
        }
        for colour in colours.chunks_exact(3) {
            let (across, down) = (usize::from(colour[1] >> 4), usize::from(colour[1] & 15));
            if ![1, 2, 4].contains(&across) || ![1, 2, 4].contains(&down) {
                return Err(invalid(format!(
                    "a colour of the JPEG is sampled {across} x {down}, 1, 2 or 4 are allowed"
                )));
            }
            let (id, quantization) = (colour[0], colour[2]);
            if self.components.iter().any(|c| c.id == id) {
                return Err(invalid(format!("the JPEG has colour {id} twice")));
            }
            self.components.push(Component { id, quantization, across, down, steps: [1; 64], dc: 0, ac: 0 });
        }
        let blocks: usize = self.components.iter().map(|c| c.across * c.down).sum();
        if blocks > 10 && count > 1 {
            return Err(invalid(format!("a unit of the JPEG has {blocks} blocks, 10 are allowed")));
        }
        // Elsewhere samples of a colour would have to be made from those of two.
        let first = self.components.first().map_or([1, 1], |c| [c.across, c.down]);
        if self.components.iter().any(|c| c.across > first[0] || c.down > first[1]) {
            return Err(invalid("the JPEG has more samples of another colour than of its first"));
        }
        self.size = Some([width, height]);
        Ok(())
    }

    fn quantization(&mut self, mut segment: &[u8]) -> Result<(), Error> {
        while let Some((&kind, rest)) = segment.split_first() {
            let wide = kind >> 4;
            let size = 64 << wide.min(1);
            let (Some(table), true, Some(values)) =
                (self.quantization.get_mut(usize::from(kind & 15)), wide < 2, rest.get(..size))
            else {
                return Err(short("quantization table", segment));
            };
            let mut steps = [0; 64];
            for (i, step) in steps.iter_mut().enumerate() {
                *step = match wide {
                    0 => u16::from(values[i]),
                    _ => u16::from_be_bytes([values[2 * i], values[2 * i + 1]]),
                };
            }
            if steps.contains(&0) {
                return Err(invalid(
                    "a quantization table of the JPEG has a step of 0, 1 or more are allowed",
                ));
            }
            *table = Some(steps);
            segment = &rest[size..];
        }
        Ok(())
    }

    fn huffman(&mut self, mut segment: &[u8]) -> Result<(), Error> {
        while let Some((&kind, rest)) = segment.split_first() {
            let Some((counts, rest)) = rest.split_first_chunk::<16>() else {
                return Err(short("Huffman table", segment));
            };
            let size = counts.iter().map(|count| usize::from(*count)).sum();
            let slot =
                self.codes.get_mut(usize::from(kind >> 4)).and_then(|t| t.get_mut(usize::from(kind & 15)));
            let (Some(table), Some(symbols)) = (slot, rest.get(..size)) else {
                return Err(short("Huffman table", segment));
            };
            *table = Some(Codes::new(*counts, symbols)?);
            segment = &rest[size..];
        }
        Ok(())
    }

    fn scan(mut self, segment: &[u8], scan_header_at: usize, data_at: usize) -> Result<Header, Error> {
        let Some([width, height]) = self.size else {
            return Err(invalid("the JPEG has no frame header before its data"));
        };
        let count = segment.first().copied().map_or(0, usize::from);
        if count != self.components.len() {
            return Err(invalid(format!(
                "the JPEG is not interleaved: its first scan has {count} of {} colours, all are needed",
                self.components.len()
            )));
        }
        if segment.len() != 4 + 2 * count {
            return Err(short("scan header", segment));
        }
        if segment[1 + 2 * count..] != [0, 63, 0] {
            return Err(invalid("the JPEG's scan has a part of the coefficients, all are needed"));
        }
        let tables =
            self.codes.iter().flatten().all(Option::is_none).then(|| self.use_standard()).transpose()?;
        let mut header = Header {
            units: units(&mut self.components, width, height),
            components: self.components,
            restart: self.restart,
            dc: Default::default(),
            ac: Default::default(),
            scan_header_at,
            data_at,
            tables,
        };
        let [dc_codes, mut ac_codes] = self.codes;
        header.dc = dc_codes.map(|codes| codes.map(Sizes::new));
        for (component, named) in header.components.iter_mut().zip(segment[1..].chunks_exact(2)) {
            if named[0] != component.id {
                return Err(invalid(format!(
                    "the JPEG's scan has colour {}, colour {} is next",
                    named[0], component.id
                )));
            }
            (component.dc, component.ac) = (usize::from(named[1] >> 4), usize::from(named[1] & 15));
            let steps = self.quantization.get(usize::from(component.quantization)).copied().flatten();
            component.steps = steps.ok_or_else(|| {
                invalid(format!("the JPEG lacks quantization table {}", component.quantization))
            })?;
            if header.dc.get(component.dc).is_none_or(Option::is_none) {
                return Err(invalid(format!("the JPEG lacks Huffman table {} of class 0", component.dc)));
            }
            if let Some(codes) = ac_codes.get_mut(component.ac).and_then(Option::take) {
                header.ac[component.ac] = Some(Steps::new(codes));
            }
            if header.ac.get(component.ac).is_none_or(Option::is_none) {
                return Err(invalid(format!("the JPEG lacks Huffman table {} of class 1", component.ac)));
            }
        }
        Ok(header)
    }

    /// Takes the tables of the standard; returns them as a segment.
    fn use_standard(&mut self) -> Result<Vec<u8>, Error> {
        let mut body = Vec::new();
        for (kind, codes) in standard()? {
            body.push(kind);
            body.extend(codes.bytes());
            self.codes[usize::from(kind >> 4)][usize::from(kind & 15)] = Some(codes);
        }
        let length = u16::try_from(body.len() + 2).unwrap_or(u16::MAX);
        Ok([&[0xff, 0xc4], &length.to_be_bytes()[..], &body].concat())
    }
}

/// How many units the scan has across and down. A single colour has one block in each, whatever its sampling.
fn units(components: &mut [Component], width: usize, height: usize) -> [usize; 2] {
    if let [only] = components {
        (only.across, only.down) = (1, 1);
    }
    let most = |of: fn(&Component) -> usize| components.iter().map(of).max().unwrap_or(1);
    [width.div_ceil(8 * most(|c| c.across)), height.div_ceil(8 * most(|c| c.down))]
}
