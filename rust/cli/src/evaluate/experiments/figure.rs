//! Figure 22: uncertainty against length.

use super::ExperimentResults;
use super::plan::Table;
use super::series::Series;
use plotters::prelude::*; // in use for the calibration's report

const SIZE_PX: (u32, u32) = (900, 560);
/// What the paper's abstract gives for its range of 100 to 1800 mm.
const PAPER_MM: [(f64, f64); 2] = [(100.0, 0.52), (1800.0, 4.0)];

/// Scatter of repeated shots and stated sigma of every side of the twins, with the paper's range.
pub fn draw(found: &ExperimentResults) -> Result<String, String> {
    fn plot_error(e: impl std::fmt::Display) -> String {
        e.to_string()
    }
    let [orange, blue, green, red] = crate::calibrate::COLOURS;
    let of_way = |way: usize| {
        [Table::Poses, Table::Repeated, Table::Boxes]
            .into_iter()
            .flat_map(|table| found.of(table))
            .flat_map(move |(_, tallies)| &tallies[way].sides)
    };
    let points = |way: usize, sigma_mm: fn(&Series) -> Option<f64>| {
        of_way(way).filter_map(|s| Some((s.truth_mm, sigma_mm(s)?))).collect::<Vec<_>>()
    };
    let mut clouds = vec![(points(0, Series::stated_mm), green, "Fit: stated standard deviation".to_owned())];
    for (way, ((_, name), colour)) in found.ways.iter().zip([blue, orange, red]).enumerate() {
        clouds.insert(0, (points(way, Series::scatter_mm), colour, format!("{name}: scatter of shots")));
    }
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, SIZE_PX).into_drawing_area();
        area.fill(&WHITE).map_err(plot_error)?;
        let mut chart = ChartBuilder::on(&area)
            .margin(12)
            .x_label_area_size(36)
            .y_label_area_size(52)
            .build_cartesian_2d(0.0..1900.0, (0.02f64..20.0).log_scale())
            .map_err(plot_error)?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .x_desc("length, mm")
            .y_desc("standard deviation, mm")
            .draw()
            .map_err(plot_error)?;
        chart
            .draw_series(LineSeries::new(PAPER_MM, BLACK.stroke_width(2)))
            .map_err(plot_error)?
            .label("the paper: 0.52 to 4.0")
            .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 14, y)], BLACK.stroke_width(2)));
        for (points, colour, name) in clouds {
            let dots = points.into_iter().map(|at| Circle::new(at, 4, colour.filled()));
            chart
                .draw_series(dots)
                .map_err(plot_error)?
                .label(name)
                .legend(move |(x, y)| Circle::new((x + 7, y), 4, colour.filled()));
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::LowerRight)
            .background_style(WHITE)
            .border_style(BLACK)
            .draw()
            .map_err(plot_error)?;
        area.present().map_err(plot_error)?;
    }
    Ok(svg)
}
