//! Results as text for people.

use boxline::measurement::FaceMeasurement;
use boxline::{
    BoxMeasurement, BoxReport, DepthEstimate, Estimate, FaceOutcome, FaceReport, Hint, Outcome, Reject,
    SideLight, Volume, Warning, WarningKind,
};

/// A box, in lines.
pub fn of_box(report: &BoxReport, names: &[&str]) -> String {
    let mut text = String::new();
    match &report.outcome {
        Outcome::Measured(measurement) => {
            push(&mut text, &sides(measurement));
            push(&mut text, "(± is one standard deviation, [ ] hold the truth 95 times in 100)");
            push_confidence(&mut text, report.confidence);
            if let Some(seen) = &report.settled {
                push(&mut text, &settled(seen));
            }
        }
        Outcome::Ambiguous([first, second]) => {
            push(&mut text, "Two boxes are possible: both frames show sides of the same two lengths.");
            push(&mut text, &format!("\nchoice 1\n{}\n\nchoice 2\n{}\n", sides(first), sides(second)));
            push(
                &mut text,
                "What to do: settle it with --choose 1 or --choose 2, or add a frame of the third face.",
            );
        }
        Outcome::Rejected(reject) => {
            push(&mut text, &format!("box: {}", refusal(reject)));
            for likely in &report.likeliest {
                let [l, w, h] =
                    [likely.sides.length, likely.sides.width, likely.sides.height].map(|s| s.value_mm);
                push(
                    &mut text,
                    &format!(
                        "perhaps {l:.1} x {w:.1} x {h:.1} mm, with a probability of {:.2}",
                        likely.confidence
                    ),
                );
            }
            if report.third_face_helps() {
                push(&mut text, "A frame of a third face may settle it: give all three.");
            }
        }
    }
    warnings(&mut text, &report.warnings);
    push(&mut text, "");
    for (i, (face, name)) in report.faces.iter().zip(names).enumerate() {
        push(&mut text, &format!("frame {name}: {}", face_line(face)));
        if let FaceOutcome::Measured(face) = face {
            beside(&mut text, face);
        }
        push_hint(&mut text, report.hint(i));
    }
    text
}

/// A single face, in lines.
pub fn of_face(report: &FaceReport, name: &str) -> String {
    let mut text = String::new();
    match &report.outcome {
        FaceOutcome::Measured(m) => {
            push(&mut text, &line("length", m.length));
            push(&mut text, &line("width", m.width));
            push(&mut text, "(± is one standard deviation, [ ] hold the truth 95 times in 100)");
            push_confidence(&mut text, m.confidence);
            push(&mut text, &format!("\nframe {name}: residuals {:.2} px rms", m.rms_px));
            beside(&mut text, m);
        }
        FaceOutcome::Rejected(reject) => push(&mut text, &format!("frame {name}: {}", refusal(reject))),
    }
    push_hint(&mut text, report.hint.as_ref());
    text
}

/// How probable it is that the sides lie on the right lines, if that is stated.
fn push_confidence(text: &mut String, confidence: Option<f64>) {
    match confidence {
        // Nothing is certain.
        Some(confidence) if confidence > 0.99 => push(text, "right with a probability above 0.99"),
        Some(confidence) => push(text, &format!("right with a probability of {confidence:.2}")),
        None => {}
    }
}

/// How to move, if moving helps.
fn push_hint(text: &mut String, hint: Option<&Hint>) {
    if let Some(hint) = hint {
        push(text, &format!("How to move: {hint}."));
    }
}

/// What stands below a face: its angles, if they were measured, and its warnings.
fn beside(text: &mut String, face: &FaceMeasurement) {
    if let Some(angles) = &face.corner_angles {
        let angle = |a: &boxline::AngleEstimate| {
            format!("{:.2} ± {:.2}", a.value_rad.to_degrees(), a.sigma_rad.to_degrees())
        };
        let angles: Vec<String> = angles.iter().map(angle).collect();
        push(text, &format!("corners {} degrees", angles.join(", ")));
    }
    if let Some(light) = &face.light {
        let count = |what: SideLight| light.iter().filter(|light| **light == what).count();
        let counts = SideLight::ALL.map(|what| (count(what), what.name()));
        let counts = counts.iter().filter(|(n, _)| *n > 0).map(|(n, name)| format!("{n} {name}"));
        push(text, &format!("sides by the lasers: {}", counts.collect::<Vec<_>>().join(", ")));
    }
    warnings(text, &face.warnings);
}

fn warnings(text: &mut String, warnings: &[Warning]) {
    for warning in warnings {
        push(text, &format!("warning: {warning}; {}", what_it_means(warning.kind)));
    }
}

/// What to make of a warning.
fn what_it_means(kind: WarningKind) -> &'static str {
    match kind {
        WarningKind::LaserMoved => "sizes may be off, have the head calibrated again",
        WarningKind::FaceNotFlat => "the sizes allow for it, press the face flat for better ones",
        WarningKind::NotRightAngled | WarningKind::OppositeEdges => {
            "the sizes are means of opposite edges, --free prints the angles"
        }
        WarningKind::EdgeDouble => "the sigmas allow for it",
        WarningKind::SideBowed => "the sizes allow for it; a tunnel on a belt reads the enclosing box",
        WarningKind::SidesDiffer => "see that both frames show the same box and its flaps are down",
        _ => "the sigmas allow for it",
    }
}

/// Why it is this box although both frames show sides of the same two lengths.
fn settled(seen: &DepthEstimate) -> String {
    format!(
        "Both frames show sides of the same two lengths; {} stripes on the faces beside them end {:.0} ± {:.0} mm behind, which \
         leaves this box.",
        seen.stripes, seen.depth.value_mm, seen.depth.sigma_mm
    )
}

fn push(text: &mut String, line: &str) {
    text.push_str(line);
    text.push('\n');
}

fn sides(m: &BoxMeasurement) -> String {
    let mut text = String::new();
    for (name, side) in [("length", m.length), ("width", m.width), ("height", m.height)] {
        push(&mut text, &line(name, side));
    }
    text.push_str(&format!("volume {}", volume(m.volume)));
    text
}

/// A volume in m³ with as many digits as its standard deviation leaves sense in.
pub fn volume(volume: Volume) -> String {
    // Two digits of sigma; a NaN ends as 3.
    let digits = (2.0 - volume.sigma_m3.log10().ceil()).clamp(3.0, 8.0) as usize;
    format!("{:.digits$} m³ ± {:.digits$}", volume.value_m3, volume.sigma_m3)
}

fn line(name: &str, side: Estimate) -> String {
    let [low, high] = side.interval_95_mm();
    format!("{name:<6} {:>9.2} mm ± {:.2}  [{low:.2}, {high:.2}]", side.value_mm, side.sigma_mm)
}

fn face_line(face: &FaceOutcome) -> String {
    match face {
        FaceOutcome::Measured(m) => format!(
            "face of {:.2} ± {:.2} x {:.2} ± {:.2} mm, residuals {:.2} px rms",
            m.length.value_mm, m.length.sigma_mm, m.width.value_mm, m.width.sigma_mm, m.rms_px
        ),
        FaceOutcome::Rejected(reject) => format!("refused, {reject}"),
    }
}

fn refusal(reject: &Reject) -> String {
    let mut text = format!("not measured, {reject}");
    if let Some(advice) = advice(reject) {
        text.push_str("\nWhat to do: ");
        text.push_str(advice);
    }
    text
}

/// What to do about a refusal, where its own text does not say it.
fn advice(reject: &Reject) -> Option<&'static str> {
    Some(match reject {
        Reject::NoBox { .. } => "point the head at one face of the box, so that all four stripes lie on it.",
        Reject::StripeNotFound { .. } => {
            "go closer or shade the face from the sun; see that all four lasers shine."
        }
        Reject::FaceNotPlanar { .. } => {
            "press flaps down, take another face, or have the head calibrated again."
        }
        Reject::RectangleOpen { .. } => "look straighter at the face, with all its edges free and in view.",
        Reject::OutlineUnsure { .. } => {
            "see that the whole face is in view, evenly lit and clear of its neighbours."
        }
        Reject::FaceHidden { .. } => "clear what stands before the face, or look past it.",
        Reject::TooFar { .. } => "go closer, until the face fills the picture.",
        Reject::NotARectangle { .. } => "see that the whole face is in view and nothing covers its edges.",
        Reject::SidesDisagree { .. } => "take two faces of the same box that share an edge.",
        _ => return None,
    })
}
