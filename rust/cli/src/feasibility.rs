//! `boxline feasibility`: which faces a head can measure from where, and how well, from its calibration alone.

use crate::Finished;
use crate::input::Usage;
use boxline::Calibration;
use boxline::feasibility::{SideSigmas, WorkingRange, working_ranges};
use boxline_proto::json::read_calibration;
use clap::Args as ClapArgs;
use plotters::prelude::*; // in use for the calibration's report
use serde_json::{Value, json};
use std::path::PathBuf;

const DONE: u8 = 0;
/// Lengths in the table, mm, and widths as shares of them.
const LENGTHS_MM: [f64; 11] =
    [100.0, 150.0, 200.0, 300.0, 450.0, 600.0, 800.0, 1000.0, 1200.0, 1500.0, 1800.0];
const SHARES: [f64; 3] = [1.0, 0.6, 0.3];
const PICTURE_PX: (u32, u32) = (900, 560);

#[derive(ClapArgs)]
pub struct FeasibilityArgs {
    /// The head's calibration
    #[arg(long, value_name = "FILE")]
    pub calibration: PathBuf,
    /// Only this face, mm
    #[arg(long, value_name = "LENGTHxWIDTH", allow_hyphen_values = true, value_parser = size)]
    pub face: Option<[f64; 2]>,
    /// Draw sigma of the length over distance (.svg)
    #[arg(long, value_name = "FILE")]
    pub picture: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

fn size(text: &str) -> Result<[f64; 2], String> {
    let parse =
        |part: &str| part.trim().parse::<f64>().ok().filter(|mm| mm.is_finite() && *mm > 0.0 && *mm < 1e5);
    let sides = text.split_once(['x', 'X']).and_then(|(a, b)| Some([parse(a)?, parse(b)?]));
    let [a, b] = sides.ok_or("two lengths in mm are needed, as 800x600")?;
    Ok([a.max(b), a.min(b)])
}

/// A face with the distances from which it can be measured.
struct Row {
    size_mm: [f64; 2],
    working_ranges: Vec<WorkingRange>,
}

impl Row {
    /// The distance with the smallest sigma of the length.
    fn best(&self) -> Option<&WorkingRange> {
        self.working_ranges.iter().min_by(|a, b| a.length.total_mm().total_cmp(&b.length.total_mm()))
    }
}

/// Runs `boxline feasibility`.
pub fn feasibility(args: &FeasibilityArgs) -> anyhow::Result<Finished> {
    let calibration = read_calibration(&args.calibration)?;
    let sizes = match args.face {
        Some(size) => vec![size],
        None => SHARES.iter().flat_map(|s| LENGTHS_MM.map(|length| [length, length * s])).collect(),
    };
    let rows: Vec<Row> = sizes
        .into_iter()
        .map(|size_mm| Row { size_mm, working_ranges: working_ranges(&calibration, size_mm[0], size_mm[1]) })
        .collect();
    if let Some(path) = &args.picture {
        if path.extension().is_none_or(|e| !e.eq_ignore_ascii_case("svg")) {
            return Err(Usage(format!("{}: the picture is an .svg", path.display())).into());
        }
        let svg = picture(&rows).map_err(anyhow::Error::msg)?;
        std::fs::write(path, svg)
            .map_err(|e| anyhow::Error::new(e).context(format!("{}: cannot write", path.display())))?;
    }
    let stdout =
        if args.json { all_json(&rows, &calibration).to_string() } else { table(&rows, &calibration) };
    Ok(Finished { stdout, exit_code: DONE })
}

fn table(rows: &[Row], calibration: &Calibration) -> String {
    let header = ["face, mm", "from, mm", "to, mm", "best at, mm", "± length, mm", "± width, mm", "mostly"];
    let mut table = crate::evaluate::table(&header, 1);
    for row in rows {
        let [length, width] = row.size_mm;
        let name = format!("{length:.0} x {width:.0}");
        match (row.working_ranges.first(), row.working_ranges.last(), row.best()) {
            (Some(near), Some(far), Some(best)) => table.add_row([
                name,
                format!("{:.0}", near.distance_mm),
                format!("{:.0}", far.distance_mm),
                format!("{:.0}", best.distance_mm),
                format!("{:.2}", best.length.total_mm()),
                format!("{:.2}", best.width.total_mm()),
                main_cause(&best.length).to_owned(),
            ]),
            _ => table.add_row([
                name,
                "-".into(),
                "-".into(),
                "cannot be measured".into(),
                "-".into(),
                "-".into(),
                String::new(),
            ]),
        };
    }
    let note = if calibration.covariance().is_none() {
        "\n(the calibration has no covariance: its own share of ± is not counted)"
    } else {
        ""
    };
    format!(
        "{table}\nFacing the head, rolled so that the stripes run along the sides. Distances to the face's middle, tried from 250 to\n\
         3000 mm; ± is one standard deviation: points, calibration, lasers that drift by 0.05 mrad, rounded edges.{note}"
    )
}

/// The cause that weighs most.
fn main_cause(s: &SideSigmas) -> &'static str {
    let causes = [
        ("points", s.points_mm),
        ("calibration", s.calibration_mm),
        ("drift", s.drift_mm),
        ("rounded edges", s.rounding_mm),
    ];
    causes.iter().fold(causes[0], |a, b| if b.1 > a.1 { *b } else { a }).0
}

fn all_json(rows: &[Row], calibration: &Calibration) -> Value {
    let sigmas = |s: &SideSigmas| {
        json!({
            "total_mm": s.total_mm(), "points_mm": s.points_mm, "calibration_mm": s.calibration_mm,
            "drift_mm": s.drift_mm, "rounding_mm": s.rounding_mm,
        })
    };
    let reach = |r: &WorkingRange| json!({"distance_mm": r.distance_mm, "length_sigma": sigmas(&r.length), "width_sigma": sigmas(&r.width)});
    let row = |row: &Row| {
        json!({
            "length_mm": row.size_mm[0], "width_mm": row.size_mm[1], "feasible": !row.working_ranges.is_empty(),
            "reaches": row.working_ranges.iter().map(reach).collect::<Vec<_>>(),
        })
    };
    json!({
        "outcome": "predicted",
        "serial": calibration.serial(),
        "calibration_has_covariance": calibration.covariance().is_some(),
        "faces": rows.iter().map(row).collect::<Vec<_>>(),
    })
}

/// Sigma of the length over distance, one curve a face.
fn picture(rows: &[Row]) -> Result<String, String> {
    fn plot_error(e: impl std::fmt::Display) -> String {
        e.to_string()
    }
    let all = || rows.iter().flat_map(|r| &r.working_ranges);
    let far = all().map(|r| r.distance_mm).fold(1000.0, f64::max);
    let most = all().map(|r| r.length.total_mm()).fold(0.5, f64::max);
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, PICTURE_PX).into_drawing_area();
        area.fill(&WHITE).map_err(plot_error)?;
        let mut chart = ChartBuilder::on(&area)
            .margin(12)
            .x_label_area_size(36)
            .y_label_area_size(52)
            .build_cartesian_2d(0.0..far * 1.05, 0.0..most * 1.1)
            .map_err(plot_error)?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .x_desc("distance, mm")
            .y_desc("standard deviation of the length, mm")
            .draw()
            .map_err(plot_error)?;
        for (i, row) in rows.iter().filter(|r| !r.working_ranges.is_empty()).enumerate() {
            let colour = crate::calibrate::COLOURS[i % crate::calibrate::COLOURS.len()];
            let points = row.working_ranges.iter().map(|r| (r.distance_mm, r.length.total_mm()));
            chart.draw_series(LineSeries::new(points, colour.stroke_width(2))).map_err(plot_error)?;
            if let Some(last) = row.working_ranges.last() {
                let name = format!("{:.0} x {:.0}", row.size_mm[0], row.size_mm[1]);
                let at = (last.distance_mm, last.length.total_mm());
                let label = Text::new(name, at, ("sans-serif", 11).into_font().color(&colour));
                chart.draw_series([label]).map_err(plot_error)?;
            }
        }
        area.present().map_err(plot_error)?;
    }
    Ok(svg)
}
