//! The report's pictures, each an SVG drawn by `plotters`.

use super::Solved;
use boxline::LaserId;
use plotters::prelude::*;

const SIZE: (u32, u32) = (640, 480);
const WIDE: (u32, u32) = (640, 260);
/// The four lasers, apart for colour-blind readers too.
pub const COLOURS: [RGBColor; 4] =
    [RGBColor(213, 94, 0), RGBColor(0, 114, 178), RGBColor(0, 158, 115), RGBColor(204, 121, 167)];
/// Residual vectors are drawn so many times too long.
pub const MAGNIFIED: f64 = 1000.0;
const COLUMNS: usize = 16;
const ROWS: usize = 12;

type Drawn = Result<String, String>;

fn draw(
    size: (u32, u32),
    paint: impl FnOnce(&DrawingArea<SVGBackend, plotters::coord::Shift>) -> Result<(), String>,
) -> Drawn {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        area.fill(&WHITE).map_err(plot_error)?;
        paint(&area)?;
        area.present().map_err(plot_error)?;
    }
    Ok(svg)
}

fn plot_error(e: impl std::fmt::Display) -> String {
    e.to_string()
}

/// Mean residual of the circles in the cells of the sensor, as vectors: a pattern here is a lens that the model lacks.
pub fn vectors(solved: &Solved) -> Drawn {
    let [width, height] = solved.size_px.map(|n| n as f64);
    let mut cells = vec![(0.0, 0.0, 0.0, 0.0, 0.0); COLUMNS * ROWS];
    for c in solved.solution.frames.iter().flat_map(|f| &f.centres).filter(|c| c.used) {
        let cell = |x: f64, size: f64, n: usize| ((x / size * n as f64).max(0.0) as usize).min(n - 1);
        let sum = &mut cells[cell(c.at.v, height, ROWS) * COLUMNS + cell(c.at.u, width, COLUMNS)];
        sum.0 += c.at.u;
        sum.1 += c.at.v;
        sum.2 += c.residual_px.x;
        sum.3 += c.residual_px.y;
        sum.4 += 1.0;
    }
    draw(SIZE, |area| {
        let mut chart = sensor(area, width, height)?;
        for (u, v, du, dv, n) in cells.into_iter().filter(|c| c.4 >= 3.0) {
            let from = (u / n, v / n);
            let to = (from.0 + MAGNIFIED * du / n, from.1 + MAGNIFIED * dv / n);
            chart
                .draw_series([PathElement::new(vec![from, to], COLOURS[1].stroke_width(2))])
                .map_err(plot_error)?;
            chart.draw_series([Circle::new(from, 3, COLOURS[1].filled())]).map_err(plot_error)?;
        }
        Ok(())
    })
}

/// Where circles were seen.
pub fn coverage(solved: &Solved) -> Drawn {
    let [width, height] = solved.size_px.map(|n| n as f64);
    draw(SIZE, |area| {
        let mut chart = sensor(area, width, height)?;
        let centres = solved.solution.frames.iter().flat_map(|f| &f.centres);
        let dots = centres.map(|c| {
            let colour = if c.used { BLACK.mix(0.35) } else { RED.mix(1.0) };
            Circle::new((c.at.u, c.at.v), 2, colour.filled())
        });
        chart.draw_series(dots).map_err(plot_error)?;
        Ok(())
    })
}

type SensorChart<'a, 'b> = ChartContext<
    'a,
    SVGBackend<'b>,
    Cartesian2d<plotters::coord::types::RangedCoordf64, plotters::coord::types::RangedCoordf64>,
>;

fn sensor<'a, 'b>(
    area: &'a DrawingArea<SVGBackend<'b>, plotters::coord::Shift>,
    width: f64,
    height: f64,
) -> Result<SensorChart<'a, 'b>, String> {
    let mut chart = ChartBuilder::on(area)
        .margin(12)
        .x_label_area_size(34)
        .y_label_area_size(52)
        .build_cartesian_2d(0.0..width, height..0.0)
        .map_err(plot_error)?;
    chart
        .configure_mesh()
        .light_line_style(WHITE)
        .x_desc("u, px")
        .y_desc("v, px")
        .draw()
        .map_err(plot_error)?;
    Ok(chart)
}

/// Residual of a laser's stripes along the stripe, over distance from the camera.
pub fn stripe_residuals(solved: &Solved, laser: LaserId) -> Drawn {
    let points: Vec<(f64, f64, bool)> = solved
        .solution
        .frames
        .iter()
        .flat_map(|f| &f.stripes)
        .filter(|s| s.laser == laser)
        .map(|s| (s.depth_mm, s.residual_px, s.used))
        .collect();
    let (near, far) = points.iter().fold((f64::INFINITY, 0.0f64), |(n, f), p| (n.min(p.0), f.max(p.0)));
    // Means of 50 mm say what single points hide.
    let mut bins = std::collections::BTreeMap::<i64, (f64, f64)>::new();
    for (depth, residual, _) in points.iter().filter(|p| p.2) {
        let (sum, n) = bins.entry((depth / 50.0) as i64).or_default();
        *sum += residual;
        *n += 1.0;
    }
    draw(WIDE, |area| {
        let mut chart = ChartBuilder::on(area)
            .margin(12)
            .x_label_area_size(34)
            .y_label_area_size(52)
            .build_cartesian_2d(near.min(far) - 20.0..far + 20.0, -0.8..0.8)
            .map_err(plot_error)?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .y_labels(5)
            .x_desc("distance, mm")
            .y_desc("residual, px")
            .draw()
            .map_err(plot_error)?;
        let shown = points.iter().filter(|p| p.1.abs() < 0.8).step_by(1 + points.len() / 2500);
        let dots = shown.map(|(depth, residual, used)| {
            let colour = if *used { COLOURS[laser.index()].mix(0.25) } else { RED.mix(0.6) };
            Circle::new((*depth, *residual), 1, colour.filled())
        });
        chart.draw_series(dots).map_err(plot_error)?;
        let means = bins
            .iter()
            .filter(|(_, (_, n))| *n >= 10.0)
            .map(|(bin, (sum, n))| ((*bin as f64 + 0.5) * 50.0, sum / n));
        chart.draw_series(LineSeries::new(means, BLACK.stroke_width(2))).map_err(plot_error)?;
        Ok(())
    })
}

/// Where each laser was seen: on the sensor's columns, over distance.
pub fn laser_coverage(solved: &Solved) -> Drawn {
    let width = solved.size_px[0] as f64;
    let all = || solved.solution.frames.iter().flat_map(|f| &f.stripes);
    let far = all().map(|s| s.depth_mm).fold(0.0, f64::max);
    draw(SIZE, |area| {
        let mut chart = ChartBuilder::on(area)
            .margin(12)
            .x_label_area_size(34)
            .y_label_area_size(52)
            .build_cartesian_2d(0.0..width, 0.0..far * 1.05)
            .map_err(plot_error)?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .x_desc("u, px")
            .y_desc("distance, mm")
            .draw()
            .map_err(plot_error)?;
        for id in LaserId::ALL {
            let points: Vec<_> = all().filter(|s| s.laser == id).collect();
            let dots = points.iter().step_by(1 + points.len() / 1500);
            let colour = COLOURS[id.index()];
            chart
                .draw_series(dots.map(|s| Circle::new((s.at.u, s.depth_mm), 1, colour.mix(0.5).filled())))
                .map_err(plot_error)?;
        }
        Ok(())
    })
}
