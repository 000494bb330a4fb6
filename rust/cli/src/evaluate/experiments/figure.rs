//! Figure 22: uncertainty against length.

use super::Experiments;
use plotters::prelude::*; // in use for the calibration's report

const SIZE_PX: (u32, u32) = (900, 560);
/// What the paper's abstract gives for its range of 100 to 1800 mm.
const PAPER_MM: [(f64, f64); 2] = [(100.0, 0.52), (1800.0, 4.0)];

/// Scatter of repeated shots and stated sigma of every side of the twins, with the paper's range.
pub fn draw(found: &Experiments) -> Result<String, String> {
    fn told(e: impl std::fmt::Display) -> String {
        e.to_string()
    }
    let [orange, blue, green, _] = crate::calibrate::COLOURS;
    let of_way = |way: usize| {
        let boxes = found.repeated.iter().chain(&found.boxes).flat_map(move |b| b.sides[way].iter());
        found.poses.iter().flat_map(move |p| p.sides[way].iter()).chain(boxes)
    };
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, SIZE_PX).into_drawing_area();
        area.fill(&WHITE).map_err(told)?;
        let mut chart = ChartBuilder::on(&area)
            .margin(12)
            .x_label_area_size(36)
            .y_label_area_size(52)
            .build_cartesian_2d(0.0..1900.0, (0.02f64..20.0).log_scale())
            .map_err(told)?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .x_desc("length, mm")
            .y_desc("standard deviation, mm")
            .draw()
            .map_err(told)?;
        chart
            .draw_series(LineSeries::new(PAPER_MM, BLACK.stroke_width(2)))
            .map_err(told)?
            .label("the paper: 0.52 to 4.0")
            .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 14, y)], BLACK.stroke_width(2)));
        let scatter = |way| of_way(way).filter_map(|s| Some((s.truth_mm, s.scatter_mm()?)));
        let stated = of_way(0).filter_map(|s| Some((s.truth_mm, s.stated_mm()?)));
        let dots = |points: Vec<(f64, f64)>, colour: RGBColor| {
            points.into_iter().map(move |at| Circle::new(at, 4, colour.filled()))
        };
        for (points, colour, name) in [
            (scatter(1).collect::<Vec<_>>(), orange, "key points: scatter of shots"),
            (scatter(0).collect(), blue, "fit: scatter of shots"),
            (stated.collect(), green, "fit: stated standard deviation"),
        ] {
            chart
                .draw_series(dots(points, colour))
                .map_err(told)?
                .label(name)
                .legend(move |(x, y)| Circle::new((x + 7, y), 4, colour.filled()));
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::LowerRight)
            .background_style(WHITE)
            .border_style(BLACK)
            .draw()
            .map_err(told)?;
        area.present().map_err(told)?;
    }
    Ok(svg)
}
