//! The report: one HTML file with everything in it, written by `maud` (checked at compile time, escapes what it inserts).

use super::{SIDES_MM, Solved, advice_text, camera_rows, lens_text, plots, warnings};
use boxline::LaserId;
use boxline_calib::tilt_deg;
use boxline_calib::uncertainty::usual_distance_mm;
use maud::{DOCTYPE, Markup, PreEscaped, html};

const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;max-width:1340px;margin:2em auto;padding:0 1em;color:#222}\
    h1{font-size:1.6em}h2{font-size:1.2em;margin-top:2em;border-bottom:1px solid #ccc}\
    table{border-collapse:collapse;margin:.5em 0}td,th{padding:.15em .9em;text-align:right;border-bottom:1px solid #eee}\
    td:first-child,th:first-child{text-align:left}figure{display:inline-block;margin:.5em .5em 1em 0;vertical-align:top}\
    figcaption{max-width:620px;color:#555}.good{color:#06713a}.bad{color:#b00020}svg{max-width:100%}";
/// A calibration that takes less than this from the 1 mm of an 1800 mm side is no limit to a measurement.
const GOOD_SIGMA_MM: f64 = 0.25;
/// The paper's own residuals are 0.065 and 0.085 px; more than this is blur, a bent board or a moving lens.
const GOOD_RMS_PX: f64 = 0.1;

/// The whole page.
pub fn html(solved: &Solved) -> anyhow::Result<String> {
    let s = &solved.solution;
    let failed = |text: String| anyhow::anyhow!("the report's pictures: {text}");
    let vectors = plots::vectors(solved).map_err(failed)?;
    let coverage = plots::coverage(solved).map_err(failed)?;
    let laser_coverage = plots::laser_coverage(solved).map_err(failed)?;
    let mut stripes = Vec::with_capacity(4);
    for id in LaserId::ALL {
        stripes.push((id, plots::stripe_residuals(solved, id).map_err(failed)?));
    }
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head { meta charset="utf-8"; title { "Calibration of " (solved.serial) } style { (PreEscaped(STYLE)) } }
            body {
                h1 { "Calibration of head " (solved.serial) }
                (verdict(solved))
                p { (s.frames.len()) " of " (solved.names.len()) " frames, "
                    (s.frames.iter().map(|f| f.centres.len()).sum::<usize>()) " circles, "
                    (s.frames.iter().map(|f| f.stripes.len()).sum::<usize>()) " stripe points, solved together in "
                    (format!("{:.1}", solved.seconds)) " s. ± is one standard deviation." }
                h2 { "What it means for a box" }
                table {
                    tr { th { "side, mm" } th { "seen from, mm" } th { "± from the calibration alone, mm" } }
                    @for (side, sigma) in SIDES_MM.iter().zip(solved.side_sigmas_mm) {
                        tr { td { (side) } td { (format!("{:.0}", usual_distance_mm(*side))) }
                             td { (sigma.map_or("unknown".to_owned(), |x| format!("{x:.3}"))) } }
                    }
                }
                h2 { "Parameters" }
                (parameters(solved))
                h2 { "Circles" }
                (figure(&vectors, &format!("Mean residual by place on the sensor, {} times too long. A pattern is a lens that the model lacks; a good set looks random.", plots::MAGNIFIED)))
                (figure(&coverage, "Where circles were seen (red: not used). Empty corners leave the distortion there unknown."))
                h2 { "Stripes" }
                @for (id, svg) in &stripes {
                    (figure(svg, &format!("Laser {id}: residual across the stripe over distance; {:.3} px rms. Black: mean of 50 mm, which should stay at zero.", s.stripe_rms_px[id.index()])))
                }
                (figure(&laser_coverage, "Where the lasers were seen: 1 orange, 2 blue, 3 green, 4 pink. A plane is known where its colour spreads in both directions."))
                h2 { "Frames" }
                (frames(solved))
                @if let Some(advice) = &solved.advice { h2 { "Next frame" } p { (advice_text(advice)) "." } }
            }
        }
    };
    Ok(page.into_string())
}

fn verdict(solved: &Solved) -> Markup {
    let s = &solved.solution;
    let mut doubts = Vec::new();
    let rms_px = s.centre_rms_px[0].max(s.centre_rms_px[1]);
    if rms_px > GOOD_RMS_PX {
        doubts.push(format!("circles scatter by {rms_px:.3} px, {GOOD_RMS_PX} px are usual at most"));
    }
    match solved.side_sigmas_mm[3] {
        Some(sigma) if sigma <= GOOD_SIGMA_MM => {}
        Some(sigma) => doubts
            .push(format!("an 1800 mm side is uncertain by {sigma:.2} mm, {GOOD_SIGMA_MM} mm are wanted")),
        None => doubts.push("what it means for an 1800 mm side cannot be computed".to_owned()),
    }
    html! {
        @if doubts.is_empty() { p.good { b { "Trust it." } " Residuals are those of noise, and a long side loses less than " (GOOD_SIGMA_MM) " mm to the calibration." } }
        @else { p.bad { b { "Do not rely on it yet:" } " " (doubts.join("; ")) "." } }
        @for warning in warnings(solved) { p.bad { "Mind: " (warning) "." } }
        p { "Images cannot tell whether the board's pitch is what its file says: all lengths scale with it. Check one known length with " code { "boxline verify" } "." }
    }
}

fn parameters(solved: &Solved) -> Markup {
    let s = &solved.solution;
    html! {
        table {
            tr { th { "camera" } th { "value" } th { "±" } }
            @for (name, value, sigma) in camera_rows(&s.camera, s.lens, &s.covariance, s.skew_sigma_px) {
                tr { td { (name) } td { (format!("{value:.5}")) } td { (format!("{sigma:.5}")) } }
            }
        }
        p { "Lens: " (lens_text(s.lens, &s.lens_trials)) }
        table {
            tr { th { "laser plane, 1/mm" } th { "x" } th { "y" } th { "z" } th { "± x" } th { "± y" } th { "± z" } }
            @for (id, plane) in LaserId::ALL.into_iter().zip(&s.lasers) {
                tr { td { (id) }
                    @for value in plane.per_mm.iter() { td { (format!("{value:.8}")) } }
                    @for i in 0..3 { @let k = 6 + 3 * id.index() + i; td { (format!("{:.1e}", s.covariance[(k, k)].max(0.0).sqrt())) } } }
            }
        }
    }
}

fn frames(solved: &Solved) -> Markup {
    let rms = |values: &mut dyn Iterator<Item = f64>| {
        let (sum, n) = values.fold((0.0, 0.0f64), |(s, n), x| (s + x * x, n + 1.0));
        if n > 0.0 { format!("{:.3}", (sum / n).sqrt()) } else { "–".to_owned() }
    };
    html! {
        table {
            tr { th { "frame" } th { "circles" } th { "not used" } th { "rms u, px" } th { "rms v, px" } th { "distance, mm" } th { "tilt, °" }
                 @for id in LaserId::ALL { th { "laser " (id) " rms, px" } } }
            @for f in &solved.solution.frames {
                tr { td { (solved.names[solved.views[f.view]]) }
                    td { (f.centres.len()) }
                    td { (f.centres.iter().filter(|c| !c.used).count()) }
                    td { (rms(&mut f.centres.iter().filter(|c| c.used).map(|c| c.residual_px.x))) }
                    td { (rms(&mut f.centres.iter().filter(|c| c.used).map(|c| c.residual_px.y))) }
                    td { (format!("{:.0}", f.cam_from_board.translation_mm.norm())) }
                    td { (format!("{:.0}", tilt_deg(&f.cam_from_board))) }
                    @for id in LaserId::ALL { td { (rms(&mut f.stripes.iter().filter(|p| p.laser == id && p.used).map(|p| p.residual_px))) } } }
            }
        }
        @for (name, why) in &solved.left_out { p.bad { (name) " is left out: " (why) "." } }
    }
}

fn figure(svg: &str, caption: &str) -> Markup {
    html! { figure { (PreEscaped(svg)) figcaption { (caption) } } }
}
