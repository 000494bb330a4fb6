//! Stroke letters, so that no font file is needed: polylines on a grid of 4 x 6, drawn with a pen of any width.

/// Points "xy" of a glyph, polylines separated by `;`.
fn strokes(letter: char) -> &'static str {
    match letter {
        'A' => "06 20 46;14 34",
        'B' => "00 06 36 45 44 33 03;33 42 41 30 00",
        'C' => "41 30 10 01 05 16 36 45",
        'D' => "00 06 26 45 41 20 00",
        'E' => "40 00 06 46;03 33",
        'F' => "40 00 06;03 33",
        'G' => "41 30 10 01 05 16 36 45 43 23",
        'H' => "00 06;40 46;03 43",
        'I' | '1' => "20 26",
        'J' => "40 45 36 16 05",
        'K' => "00 06;40 03 46",
        'L' => "00 06 46",
        'M' => "06 00 23 40 46",
        'N' => "06 00 46 40",
        'O' | '0' => "10 30 41 45 36 16 05 01 10",
        'P' => "06 00 30 41 42 33 03",
        'Q' => "10 30 41 45 36 16 05 01 10;24 46",
        'R' => "06 00 30 41 42 33 03;23 46",
        'S' => "41 30 10 01 02 13 33 44 45 36 16 05",
        'T' => "00 40;20 26",
        'U' => "00 05 16 36 45 40",
        'V' => "00 26 40",
        'W' => "00 16 22 36 40",
        'X' => "00 46;40 06",
        'Y' => "00 23 40;23 26",
        'Z' => "00 40 06 46",
        '2' => "01 10 30 41 42 06 46",
        '3' => "00 40 22 33 44 45 36 16 05",
        '4' => "36 30 04 44",
        '5' => "40 00 03 33 44 45 36 06",
        '6' => "30 10 01 05 16 36 45 44 33 03",
        '7' => "00 40 16",
        '8' => "10 30 41 42 33 13 02 01 10;13 04 05 16 36 45 44 33",
        '9' => "43 13 02 01 10 30 41 45 36 16",
        '-' => "13 33",
        '.' => "26 26",
        ':' => "22 22;25 25",
        '/' => "06 40",
        _ => "",
    }
}

/// Width of a letter cell, in grid units; the letter itself is 4 wide and 6 high.
pub const ADVANCE: f32 = 5.6;

/// All segments of a text in grid units, x to the right from 0, y down from 0 to 6.
#[must_use]
pub fn segments(text: &str) -> Vec<[f32; 4]> {
    let mut all = Vec::new();
    for (n, letter) in text.chars().enumerate() {
        let x0 = n as f32 * ADVANCE;
        for line in strokes(letter).split(';') {
            let points: Vec<[f32; 2]> = line
                .split(' ')
                .filter_map(|p| match p.as_bytes() {
                    [x, y] => Some([x0 + f32::from(x - b'0'), f32::from(y - b'0')]),
                    _ => None,
                })
                .collect();
            all.extend(points.windows(2).map(|w| [w[0][0], w[0][1], w[1][0], w[1][1]]));
        }
    }
    all
}

/// Width of a text in grid units.
#[must_use]
pub fn width(text: &str) -> f32 {
    (text.chars().count() as f32 * ADVANCE - (ADVANCE - 4.0)).max(4.0)
}
