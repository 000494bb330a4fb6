//! The `boxline` program: parses the command line, calls the library, prints. What it measures is in `rust/core`, the file
//! formats are in `proto`; here are only the text, the table of `evaluate` and the overlay picture.
//!
//! Exit codes: 0 measured, 2 broken input or usage, 3 refused, 4 two boxes possible. Results go to standard output, errors to
//! standard error. With `--json` standard output holds exactly one object, also after an error:
//! `{"outcome": "error", "error": {"kind": "invalid_frame", "text": "a.jpg: ..."}}`.

#![deny(clippy::print_stdout, clippy::print_stderr)] // `say` and `print` write out what steers a terminal

mod args;
mod calibrate;
mod capture;
mod convert;
mod drift;
mod emulate;
mod evaluate;
mod feasibility;
mod head;
mod input;
mod measure;
mod output;
mod overlay;
#[cfg(feature = "render")]
mod render;
mod say;
mod text;
mod verify;
mod workers;

use args::{Args, Command};
use boxline::ErrorKind;
use say::{printable, say, text_of};
use serde_json::json;
use std::io::Write;
use std::process::ExitCode;

const BROKEN_INPUT: u8 = 2;

/// What a command has to say when it is done: nothing is printed before, so a failure leaves no half output.
struct Finished {
    stdout: String,
    exit_code: u8,
}

fn main() -> ExitCode {
    let wants_json = std::env::args_os().any(|argument| argument == "--json");
    let args = match Args::read() {
        Ok(args) => args,
        Err(e) if e.use_stderr() => {
            let text = e.render();
            return fail("usage", text.to_string().trim_end().trim_start_matches("error: "), wants_json);
        }
        Err(help) => return print(&help.render().to_string(), 0),
    };
    let finished = match args.command {
        Command::Measure(args) => measure::measure(&args),
        Command::Face(args) => measure::face(&args),
        Command::Evaluate(args) => evaluate::evaluate(&args),
        Command::Calibrate(args) => calibrate::calibrate(&args),
        Command::Verify(args) => verify::verify(&args),
        Command::Convert(args) => convert::convert(&args),
        Command::Drift(args) => drift::drift(&args),
        Command::Feasibility(args) => feasibility::feasibility(&args),
        Command::Devices(args) => head::list(&args),
        Command::Laser(args) => head::laser(&args),
        Command::Head(args) => head::head(&args),
        Command::Capture(args) => capture::capture(&args),
        Command::Emulate(args) => emulate::emulate(&args),
        #[cfg(feature = "render")]
        Command::Render(args) => render::render(&args),
    };
    match finished {
        Ok(Finished { stdout, exit_code }) => print(&stdout, exit_code),
        Err(e) => fail(kind_of(&e), &text_of(&e), wants_json),
    }
}

fn print(text: &str, exit_code: u8) -> ExitCode {
    if text.is_empty() {
        return ExitCode::from(exit_code); // the command has written its result itself
    }
    let mut stdout = std::io::stdout().lock();
    match stdout.write_all(printable(text.trim_end()).as_bytes()).and_then(|()| stdout.write_all(b"\n")) {
        // A reader that has seen enough (`| head`) is no failure.
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
            say(&format!("error: cannot write the result: {e}"));
            ExitCode::from(BROKEN_INPUT)
        }
        _ => ExitCode::from(exit_code),
    }
}

fn fail(kind: &str, text: &str, wants_json: bool) -> ExitCode {
    say(&format!("error: {text}"));
    if wants_json {
        return print(
            &json!({"outcome": "error", "error": {"kind": kind, "text": text}}).to_string(),
            BROKEN_INPUT,
        );
    }
    ExitCode::from(BROKEN_INPUT)
}

/// The stable name of an error's kind, as in `--json`.
fn kind_of(error: &anyhow::Error) -> &'static str {
    if let Some(error) = error.downcast_ref::<boxline::Error>() {
        return match error.kind() {
            ErrorKind::InvalidCalibration => "invalid_calibration",
            ErrorKind::CalibrationMismatch => "calibration_mismatch",
            ErrorKind::InvalidFrame => "invalid_frame",
            ErrorKind::InvalidFile => "invalid_file",
            ErrorKind::ModelFile => "model_file",
            ErrorKind::NetworkRuntime => "network_runtime",
            ErrorKind::Io => "io",
            _ => "other",
        };
    }
    if let Some(error) = error.downcast_ref::<boxline_uvc::Error>() {
        return match error.kind() {
            boxline_uvc::ErrorKind::DeviceLost => "device_lost",
            boxline_uvc::ErrorKind::DeviceBusy => "device_busy",
            boxline_uvc::ErrorKind::NotFound => "device_not_found",
            boxline_uvc::ErrorKind::PermissionDenied => "permission_denied",
            _ => "device",
        };
    }
    if error.downcast_ref::<input::Usage>().is_some() {
        return "usage";
    }
    if error.chain().any(|cause| cause.is::<std::io::Error>() || cause.is::<image::ImageError>()) {
        return "io";
    }
    "other"
}
