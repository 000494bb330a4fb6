//! What rendered boxes are made of.

use boxline_sim::{Split, Stock};
use std::path::Path;

/// Materials and photographs of a split.
pub fn stock(split: Split, photos: Option<&Path>) -> anyhow::Result<Stock> {
    Ok(match photos {
        Some(folder) => Stock::with_photos(split, folder)?,
        None => Stock::new(split),
    })
}
