//! What surfaces look like: [`noise`] tiles, [`surface`] patterns (board, wood, stone), [`ink`] bitmaps (print, labels) and
//! [`stamp`]s that put them on faces; [`kinds`] lists what there is, [`mod@carton`] draws up the look of one box with its
//! [`closure`] (flaps, tape, straps, film by [`mod@wrap`]) and [`mod@edging`] (print along its edges); [`lines`] tells which of that may be taken for an
//! edge.

pub mod carton;
pub mod closure;
pub mod edging;
pub mod font;
pub mod ink;
pub mod kinds;
pub mod lines;
pub mod noise;
pub mod stamp;
pub mod surface;
pub mod wrap;

pub use carton::carton;
pub use lines::FalseLine;
pub use stamp::{Art, Decal, Stamp};
pub use surface::{Pattern, Surface};
pub use wrap::Wrap;

/// The look of one solid: the same for every frame that shows it.
#[derive(Clone, Debug)]
pub struct Appearance {
    /// The bare surface.
    pub surface: Surface,
    /// What is printed, glued and strapped on, bottom first.
    pub decals: Vec<Decal>,
    /// Straight lines among these that run along edges and may be taken for them.
    pub lines: Vec<FalseLine>,
    /// Reflectance of the coat at normal incidence as a share; 0.02 is matt board, 0.3 varnish.
    pub gloss: f32,
    /// Film around it all.
    pub wrap: Option<Wrap>,
    /// Share of what meets it straight on that it mirrors sharply, as a polished floor does; 0 for all that is rough.
    pub mirror: f32,
}

impl Appearance {
    /// A bare surface.
    #[must_use]
    pub const fn bare(surface: Surface, gloss: f32) -> Self {
        Self { surface, decals: Vec::new(), lines: Vec::new(), gloss, wrap: None, mirror: 0.0 }
    }
}

/// sRGB bytes to linear light.
#[must_use]
pub fn linear(rgb: [u8; 3]) -> crate::vec3::V3 {
    let f = |b: u8| {
        let x = f32::from(b) / 255.0;
        if x <= 0.040_45 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }
    };
    crate::vec3::v3(f(rgb[0]), f(rgb[1]), f(rgb[2]))
}
