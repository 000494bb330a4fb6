//! The pictures of the page: stated against observed probability, and wrong against measured.

use super::summary::Confidence;
use plotters::prelude::*; // in use for the calibration's report

const SIZE_PX: (u32, u32) = (640, 480);

fn plot_error(e: impl std::fmt::Display) -> String {
    e.to_string()
}

/// Share right over stated probability, by bin, with intervals of 95 %; on the line if the probabilities are true.
pub fn reliability(confidence: &Confidence) -> Result<String, String> {
    let [orange, blue, ..] = crate::calibrate::COLOURS;
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, SIZE_PX).into_drawing_area();
        area.fill(&WHITE).map_err(plot_error)?;
        let mut chart = ChartBuilder::on(&area)
            .margin(12)
            .x_label_area_size(36)
            .y_label_area_size(52)
            .build_cartesian_2d(0.0..1.0, 0.0..1.02)
            .map_err(plot_error)?;
        chart
            .configure_mesh()
            .max_light_lines(0)
            .x_desc("stated probability")
            .y_desc("share right")
            .draw()
            .map_err(plot_error)?;
        chart
            .draw_series(LineSeries::new([(0.0, 0.0), (1.0, 1.0)], orange.stroke_width(1)))
            .map_err(plot_error)?;
        for bin in &confidence.bins {
            let [low, high] = bin.right.interval;
            let bar = PathElement::new(vec![(bin.stated, low), (bin.stated, high)], blue.stroke_width(2));
            chart.draw_series([bar]).map_err(plot_error)?;
            let at = (bin.stated, bin.right.value().unwrap_or(0.0));
            chart.draw_series([Circle::new(at, 5, blue.filled())]).map_err(plot_error)?;
        }
        area.present().map_err(plot_error)?;
    }
    Ok(svg)
}

/// Share wrong of the measured over share measured of the measurable, as the limit on the stated probability falls; today's limit as a
/// dot.
pub fn risk(confidence: &Confidence) -> Result<String, String> {
    let [orange, blue, ..] = crate::calibrate::COLOURS;
    let percent = |part: usize, of: usize| 100.0 * part as f64 / of.max(1) as f64;
    let at =
        |results: usize, wrong: usize| (percent(results, confidence.measurable), percent(wrong, results));
    let curve: Vec<(f64, f64)> = confidence.limits.iter().map(|l| at(l.results, l.wrong)).collect();
    let [measured, wrong] = confidence.today;
    let today = at(measured, wrong);
    // One wrong among the first few is a spike that says little.
    let top = curve
        .iter()
        .filter(|(measured, _)| *measured > 10.0)
        .map(|(_, wrong)| *wrong)
        .fold(today.1, f64::max);
    let top = (1.2 * top).clamp(1.0, 100.0);
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, SIZE_PX).into_drawing_area();
        area.fill(&WHITE).map_err(plot_error)?;
        let mut chart = ChartBuilder::on(&area)
            .margin(12)
            .x_label_area_size(36)
            .y_label_area_size(52)
            .build_cartesian_2d(0.0..100.0, 0.0..top)
            .map_err(plot_error)?;
        chart
            .configure_mesh()
            .max_light_lines(0)
            .x_desc("measured, % of the measurable")
            .y_desc("wrong, % of the measured")
            .draw()
            .map_err(plot_error)?;
        let shown = curve.into_iter().map(|(measured, wrong)| (measured, wrong.min(top)));
        chart.draw_series(LineSeries::new(shown, blue.stroke_width(2))).map_err(plot_error)?;
        chart.draw_series([Circle::new(today, 6, orange.filled())]).map_err(plot_error)?;
        area.present().map_err(plot_error)?;
    }
    Ok(svg)
}
