//! Rendered shots: a frame as the head delivers it.

use boxline::Frame;
use boxline_sim::recording::{full_frame, jpeg};
use boxline_sim::world::{Scene, View};
use boxline_sim::{Head, Split, Stock};
use std::path::Path;

/// A full frame through the camera's JPEG.
pub fn shot(head: &Head, scene: &Scene, view: &View, seed: u64, stock: &Stock) -> anyhow::Result<Frame> {
    Ok(Frame::from_jpeg(&jpeg(&full_frame(head, scene, view, true, seed, stock), seed)?)?)
}

/// Materials and photographs of a split.
pub fn stock(split: Split, photos: Option<&Path>) -> anyhow::Result<Stock> {
    Ok(match photos {
        Some(folder) => Stock::with_photos(split, folder)?,
        None => Stock::new(split),
    })
}
