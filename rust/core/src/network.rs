//! What an edge network says of a frame: nine maps on a small raster that covers it, or the paper's single one. The network itself
//! lives in another crate (`boxline-edgenet`), which implements [`Network`] or [`EdgeMapNetwork`]; core only asks *where* to look,
//! never *how exactly*.

use crate::error::Error;
use crate::image::Frame;
use crate::image::small::{Downscaler, SMALL, SmallPicture};
use crate::units::{LaserId, Px};
use crate::view::{FaceView, SideOdds};
use std::cell::OnceCell;

/// Number of maps.
pub const CHANNELS: usize = 9;

/// One of the maps, in the order in which a network gives them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// A laser's stripe on the face that is measured; it ends at the face's edges.
    Laser(LaserId),
    /// Laser light on anything else.
    StrayLight,
    /// Edges of the face.
    FaceEdge,
    /// Edges of other faces and other boxes.
    OtherEdge,
    /// The face itself.
    FaceMask,
    /// Corners of the face.
    Corner,
}

impl Channel {
    /// All channels in order.
    pub const ALL: [Self; CHANNELS] = [
        Self::Laser(LaserId::ALL[0]),
        Self::Laser(LaserId::ALL[1]),
        Self::Laser(LaserId::ALL[2]),
        Self::Laser(LaserId::ALL[3]),
        Self::StrayLight,
        Self::FaceEdge,
        Self::OtherEdge,
        Self::FaceMask,
        Self::Corner,
    ];

    /// Its place in the order.
    #[must_use]
    pub const fn index(self) -> usize {
        match self {
            Self::Laser(id) => id.index(),
            Self::StrayLight => 4,
            Self::FaceEdge => 5,
            Self::OtherEdge => 6,
            Self::FaceMask => 7,
            Self::Corner => 8,
        }
    }
}

/// A raster that covers a frame; asked in the frame's pixels. Pixel centres are at integers on both.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Raster {
    width: usize,
    height: usize,
    /// Raster px per frame px, across and down.
    scale: [f64; 2],
}

impl Raster {
    /// `None` if a size is too small.
    fn new(width: usize, height: usize, frame_px: [usize; 2]) -> Option<Self> {
        let fits = width > 1 && height > 1 && frame_px[0] > 0 && frame_px[1] > 0;
        fits.then(|| Self {
            width,
            height,
            scale: [width as f64 / frame_px[0] as f64, height as f64 / frame_px[1] as f64],
        })
    }

    fn of_px(self, at: Px) -> [f64; 2] {
        [(at.u + 0.5) * self.scale[0] - 0.5, (at.v + 0.5) * self.scale[1] - 0.5]
    }

    fn px_of(self, x: f64, y: f64) -> Px {
        Px::new((x + 0.5) / self.scale[0] - 0.5, (y + 0.5) / self.scale[1] - 0.5)
    }

    fn px_per_raster_px(self) -> f64 {
        2.0 / (self.scale[0] + self.scale[1])
    }
}

/// One map: probabilities (0..1) on a raster that covers a frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MapView<'a> {
    raster: Raster,
    /// Rows top to bottom.
    pub values: &'a [f32],
}

impl MapView<'_> {
    /// Columns and rows of the raster.
    pub const fn size(&self) -> [usize; 2] {
        [self.raster.width, self.raster.height]
    }

    /// The frame position of a raster position.
    pub fn px_from_raster(&self, x: f64, y: f64) -> Px {
        self.raster.px_of(x, y)
    }

    /// Frame pixels per raster pixel (the mean of both directions).
    pub fn px_per_raster_px(&self) -> f64 {
        self.raster.px_per_raster_px()
    }

    /// The value at a frame position, bilinear; the border's value outside.
    pub fn at(&self, at: Px) -> f32 {
        let Raster { width, height, .. } = self.raster;
        let [x, y] = self.raster.of_px(at);
        let clamped = |v: f64, n: usize| if v.is_finite() { v.clamp(0.0, (n - 1) as f64) } else { 0.0 };
        let (x, y) = (clamped(x, width), clamped(y, height));
        let (i, j) = ((x as usize).min(width - 2), (y as usize).min(height - 2));
        let (fx, fy) = ((x - i as f64) as f32, (y - j as f64) as f32);
        let row = |j: usize| self.values[j * width + i] * (1.0 - fx) + self.values[j * width + i + 1] * fx;
        row(j) * (1.0 - fy) + row(j + 1) * fy
    }
}

/// Places of 8 px that are looked at on a line: more than any picture of a camera has.
const MOST_PLACES: u32 = 1000;

/// Probabilities (0..1) per channel on a raster that covers a frame; asked in the frame's pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct FaceMaps {
    raster: Raster,
    values: Vec<f32>,
}

impl FaceMaps {
    /// Maps of `width` x `height` that cover a frame of `frame_px`; `values` holds one channel after the other, rows top to
    /// bottom. `None` if the sizes do not fit or are 0.
    #[must_use]
    pub fn new(width: usize, height: usize, frame_px: [usize; 2], values: Vec<f32>) -> Option<Self> {
        let raster = Raster::new(width, height, frame_px)?;
        (values.len() == CHANNELS * width * height).then_some(Self { raster, values })
    }

    /// Columns and rows of the raster.
    #[must_use]
    pub const fn size(&self) -> [usize; 2] {
        [self.raster.width, self.raster.height]
    }

    /// One channel, rows top to bottom.
    #[must_use]
    pub fn channel(&self, channel: Channel) -> &[f32] {
        let n = self.raster.width * self.raster.height;
        &self.values[channel.index() * n..][..n]
    }

    /// One channel with its raster.
    pub(crate) fn view(&self, channel: Channel) -> MapView<'_> {
        MapView { raster: self.raster, values: self.channel(channel) }
    }

    /// A frame position on the raster; pixel centres are at integers on both.
    #[must_use]
    pub fn raster_from_px(&self, at: Px) -> [f64; 2] {
        self.raster.of_px(at)
    }

    /// The inverse of [`Self::raster_from_px`].
    #[must_use]
    pub fn px_from_raster(&self, x: f64, y: f64) -> Px {
        self.raster.px_of(x, y)
    }

    /// Frame pixels per raster pixel (the mean of both directions).
    #[must_use]
    pub fn px_per_raster_px(&self) -> f64 {
        self.raster.px_per_raster_px()
    }

    /// How much of a straight line from beyond a side's middle to the picture's border lies on the face: the mean of the mask, 0 to 1, from
    /// 20 px on in steps of 8. 0 where there is no such line. `outwards` has length 1.
    #[must_use]
    pub fn face_beyond(&self, middle: Px, outwards: [f64; 2]) -> f32 {
        let Raster { width, height, .. } = self.raster;
        let place = |n: u32| {
            let px = 20.0 + 8.0 * f64::from(n);
            Px::new(middle.u + px * outwards[0], middle.v + px * outwards[1])
        };
        let inside = |at: &Px| {
            let [x, y] = self.raster.of_px(*at);
            x >= 0.0 && y >= 0.0 && x <= (width - 1) as f64 && y <= (height - 1) as f64
        };
        let on: Vec<f32> =
            (0..MOST_PLACES).map(place).take_while(inside).map(|at| self.at(Channel::FaceMask, at)).collect();
        on.iter().sum::<f32>() / on.len().max(1) as f32
    }

    /// A channel's value at a frame position, bilinear; the border's value outside.
    #[must_use]
    pub fn at(&self, channel: Channel, at: Px) -> f32 {
        self.view(channel).at(at)
    }
}

/// The paper's single map of a frame (its section 3.4): the stripes on the face and the edges of the face, not told apart.
#[derive(Clone, Debug, PartialEq)]
pub struct EdgeMap {
    raster: Raster,
    values: Vec<f32>,
}

impl EdgeMap {
    /// A map of `width` x `height` probabilities (0..1) that covers a frame of `frame_px`, rows top to bottom. `None` if the sizes do
    /// not fit or are 0.
    #[must_use]
    pub fn new(width: usize, height: usize, frame_px: [usize; 2], values: Vec<f32>) -> Option<Self> {
        let raster = Raster::new(width, height, frame_px)?;
        (values.len() == width * height).then_some(Self { raster, values })
    }

    /// Columns and rows of the raster.
    #[must_use]
    pub const fn size(&self) -> [usize; 2] {
        [self.raster.width, self.raster.height]
    }

    /// The map with its raster.
    pub(crate) fn view(&self) -> MapView<'_> {
        MapView { raster: self.raster, values: &self.values }
    }
}

/// Channels, rows and columns of a [`LineStrip`].
pub const STRIP: [usize; 3] = [3, 64, 64];

/// What a frame and its maps show beside a straight line that may be a side of the face; made by core, judged by a network.
#[derive(Clone, Debug, PartialEq)]
pub struct LineStrip {
    /// As [`STRIP`]. Columns run along the line, from a fifth of the side before its begin to a fifth beyond its end. Rows 0 to 44: red,
    /// green and blue (0 to 1) from 95 px inside the face to 95 px outside, a px apart near the line and wider farther off. Rows 45 to
    /// 62, two for each of nine distances from 64 px inside to 64 px outside: face edge, other edge, face; corner, stray light, laser. Row 63: the
    /// logarithm of the line's odds by all else over 16, the edge's strength, its distance to the outline over 64 px.
    pub values: Vec<f32>,
    /// Which of the face's four sides it may be.
    pub side: usize,
    /// Its middle, and the direction outwards there (length 1).
    pub middle: Px,
    /// See above.
    pub outwards: [f64; 2],
    /// Logarithm of its odds by all else: what a network that knows nothing of lines gives.
    pub log_odds: f32,
    /// In which bin of the face's view it lies ([`FaceView`]), if there is one.
    pub bin: Option<f64>,
    /// What the stripes' light says of it.
    pub light: StripeLight,
}

/// What the light of the two stripes that cross a line says of it: logarithms of likelihood ratios, 0 where they say nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StripeLight {
    /// For light that goes on in the face's plane beyond the line, the lesser and the greater of both stripes.
    pub beyond: [f64; 2],
    /// For light that is missing inside the line where it would be seen, of both together.
    pub missing: f64,
    /// For light that goes on in the face's plane from beyond the line to the picture's border, the greater of both stripes.
    pub to_border: f64,
    /// For a seam between two boxes and against print, if the light goes on: both stripes step, or they do not.
    pub step: f64,
}

/// Finds stripes and edges in a frame, roughly (to about 2 px of a 512 px wide picture).
pub trait Network: Send + Sync {
    /// Logarithm of the odds that the line of a strip is the face's side, against the other lines of that side.
    ///
    /// # Errors
    /// As [`Self::maps`].
    fn line_log_odds(&self, strip: &LineStrip) -> Result<f32, Error> {
        Ok(strip.log_odds)
    }

    /// Where the sides of the face in a view are; `None` from a network that does not know.
    ///
    /// # Errors
    /// As [`Self::maps`].
    fn sides(&self, view: &FaceView) -> Result<Option<SideOdds>, Error> {
        let _ = view;
        Ok(None)
    }

    /// The maps of a frame.
    ///
    /// # Errors
    /// The runtime fails; never because of what the frame shows.
    fn maps(&self, frame: &Frame) -> Result<FaceMaps, Error>;
}

/// The paper's kind of network (HED, IHED): one map, for [`crate::EdgeMethod::Hough`].
pub trait EdgeMapNetwork: Send + Sync {
    /// The map of a frame.
    ///
    /// # Errors
    /// The runtime fails; never because of what the frame shows.
    fn edge_map(&self, frame: &Frame) -> Result<EdgeMap, Error>;
}

/// A network that was asked about a frame, and what it said.
pub(crate) struct NetworkOutput<'a> {
    network: &'a dyn Network,
    pub maps: FaceMaps,
    /// The frame as [`SMALL`], red, green and blue planes.
    small: Vec<f32>,
    failure: OnceCell<Error>,
}

impl<'a> NetworkOutput<'a> {
    /// Asks for the maps.
    pub fn new(network: &'a dyn Network, frame: &Frame) -> Result<Self, Error> {
        let mut small = vec![0.0; 3 * SMALL[0] * SMALL[1]];
        Downscaler::new(SMALL).run(frame, &mut small);
        Ok(Self { network, maps: network.maps(frame)?, small, failure: OnceCell::new() })
    }

    /// The frame made small.
    pub fn small(&self) -> SmallPicture<'_> {
        SmallPicture { size: SMALL, rgb: &self.small }
    }

    /// As [`Network::sides`]; what fails is kept for [`Self::finish`].
    pub fn sides(&self, view: &FaceView) -> Option<SideOdds> {
        self.network.sides(view).unwrap_or_else(|error| {
            self.failure.get_or_init(|| error);
            None
        })
    }

    /// As [`Network::line_log_odds`]; what fails is kept for [`Self::finish`].
    pub fn line_log_odds(&self, strip: &LineStrip) -> f64 {
        let log_odds = self.network.line_log_odds(strip).unwrap_or_else(|error| {
            self.failure.get_or_init(|| error);
            strip.log_odds
        });
        f64::from(log_odds)
    }

    /// What failed meanwhile.
    pub fn finish(self) -> Result<(), Error> {
        self.failure.into_inner().map_or(Ok(()), Err)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_go_there_and_back_and_values_are_found() {
        let mut values = vec![0.0; CHANNELS * 8 * 6];
        values[Channel::FaceEdge.index() * 48 + 2 * 8 + 3] = 1.0;
        let maps = FaceMaps::new(8, 6, [80, 60], values).expect("sizes fit");
        let px = maps.px_from_raster(3.0, 2.0);
        assert_eq!(maps.raster_from_px(px), [3.0, 2.0]);
        assert_eq!((px.u, px.v), (34.5, 24.5));
        assert!((maps.at(Channel::FaceEdge, px) - 1.0).abs() < 1e-6);
        assert!((maps.at(Channel::FaceEdge, Px::new(px.u + 5.0, px.v)) - 0.5).abs() < 1e-6);
        for outside in [Px::new(-1e9, 3.0), Px::new(f64::NAN, f64::INFINITY), Px::new(1e300, -1e300)] {
            assert_eq!(maps.at(Channel::FaceEdge, outside), 0.0);
        }
    }

    #[test]
    fn sizes_that_do_not_fit_are_refused() {
        assert!(FaceMaps::new(8, 6, [80, 60], vec![0.0; 9 * 47]).is_none());
        assert!(FaceMaps::new(1, 6, [80, 60], vec![0.0; 54]).is_none());
        assert!(FaceMaps::new(8, 6, [0, 60], vec![0.0; 9 * 48]).is_none());
        assert!(EdgeMap::new(8, 6, [80, 60], vec![0.0; 47]).is_none());
        assert!(EdgeMap::new(8, 6, [80, 60], vec![0.0; 48]).is_some());
    }
}
