//! Which pixels are rendered: the whole sensor, or a small frame that equals the sensor's averaged over areas.

use boxline::{CameraModel, Px};

/// A grid of pixels laid over the sensor: `net = (px + 0.5) s - 0.5`, the resizing rule of the whole project.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Raster {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Sensor pixels per pixel of this raster, along columns and rows.
    pub px_per_cell: [f64; 2],
    /// The keystone of a sensor that is tilted behind its lens, along columns and rows, 1/px: tangent of the angle over the focal length
    /// in px. 0 is a sensor that faces its lens.
    pub keystone_per_px: [f64; 2],
}

impl Raster {
    /// One pixel per sensor pixel.
    #[must_use]
    pub fn full(sensor: [u32; 2]) -> Self {
        Self::covering(sensor, sensor[0] as usize, sensor[1] as usize)
    }

    /// A small frame that covers the whole sensor.
    #[must_use]
    pub fn covering(sensor: [u32; 2], width: usize, height: usize) -> Self {
        let px_per_cell = [f64::from(sensor[0]) / width as f64, f64::from(sensor[1]) / height as f64];
        Self { width, height, px_per_cell, keystone_per_px: [0.0; 2] }
    }

    /// The sensor position of a position on this raster.
    #[must_use]
    pub fn px(&self, column: f64, row: f64) -> Px {
        let px = Px::new((column + 0.5) * self.px_per_cell[0] - 0.5, (row + 0.5) * self.px_per_cell[1] - 0.5);
        self.keystoned(px, 1.0)
    }

    /// A place d from the middle of the tilted sensor is d / (1 + t . d) on one that faces the lens; with -1 back.
    fn keystoned(&self, px: Px, way: f64) -> Px {
        if self.keystone_per_px == [0.0; 2] {
            return px;
        }
        let middle = [
            0.5 * (self.width as f64 * self.px_per_cell[0] - 1.0),
            0.5 * (self.height as f64 * self.px_per_cell[1] - 1.0),
        ];
        let [x, y] = [px.u - middle[0], px.v - middle[1]];
        let by = 1.0 + way * (self.keystone_per_px[0] * x + self.keystone_per_px[1] * y);
        Px::new(middle[0] + x / by, middle[1] + y / by)
    }

    /// The position on this raster (column, row) of a sensor position.
    #[must_use]
    pub fn from_px(&self, px: Px) -> [f64; 2] {
        let px = self.keystoned(px, -1.0);
        [(px.u + 0.5) / self.px_per_cell[0] - 0.5, (px.v + 0.5) / self.px_per_cell[1] - 0.5]
    }

    /// The same on a sensor that is tilted.
    #[must_use]
    pub const fn tilted(self, keystone_per_px: [f64; 2]) -> Self {
        Self { keystone_per_px, ..self }
    }

    /// Sensor pixels per cell, the mean of both directions.
    #[must_use]
    pub fn scale(&self) -> f64 {
        (self.px_per_cell[0] * self.px_per_cell[1]).sqrt()
    }

    /// Width of a cell at 1 mm depth, mm (its angle).
    #[must_use]
    pub fn cell_per_mm(&self, camera: &CameraModel) -> f64 {
        self.scale() / (camera.fx * camera.fy).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tilted_raster_is_its_own_inverse_and_keeps_its_middle() {
        let raster = Raster::full([2592, 1944]).tilted([3e-6, -1e-6]);
        for (column, row) in [(0.0, 0.0), (2591.0, 1943.0), (1295.5, 971.5), (300.0, 1700.0)] {
            let [c, r] = raster.from_px(raster.px(column, row));
            assert!((c - column).abs() < 1e-9 && (r - row).abs() < 1e-9, "{c} {r}");
        }
        assert_eq!(raster.px(1295.5, 971.5), Px::new(1295.5, 971.5));
        // d^2 t at the border: 1295.5^2 * 3e-6 = 5 px.
        let off = raster.px(2591.0, 971.5).u - 2591.0;
        assert!((off + 5.0).abs() < 0.1, "{off}");
    }
}
