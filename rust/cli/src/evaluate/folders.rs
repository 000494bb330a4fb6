//! `boxline evaluate FOLDER...`: a few recordings, every one in a table.

use super::in_order::in_order;
use super::recorded::{Listed, Recorded};
use super::{Broken, progress_bar, tables};
use crate::Finished;
use crate::args::EvaluateArgs;
use boxline_edgenet::AnyNet;
use boxline_proto::json::read_calibration;

/// Runs it.
pub fn evaluate(args: &EvaluateArgs) -> anyhow::Result<Finished> {
    let edges = args.edges.flatten().unwrap_or_default();
    let mut listed = Listed::default();
    for folder in &args.folders {
        listed.add(folder)?;
    }
    let override_calibration = args.calibration.as_deref().map(read_calibration).transpose()?;
    let methods = args.method.methods();
    let progress = progress_bar(listed.recordings.len())?;
    let mut scores = Vec::new();
    let mut broken: Vec<Broken> = listed.broken.into_iter().map(Broken::from).collect();
    in_order(
        &listed.recordings,
        || Ok(args.network.load_one_of_many(edges)?),
        |network: &mut Option<AnyNet>, (recording, truth)| {
            let calibration = match &override_calibration {
                Some(calibration) => calibration.clone(),
                None => read_calibration(&recording.calibration_file)?,
            };
            let recorded = Recorded::read(recording, truth, !args.ignore_off)?.with_faces(args.faces);
            let judge = |&method| {
                let settings = args.network.settings(method, edges, network.as_ref());
                recorded.judge(&calibration, &settings, method)
            };
            methods.iter().map(judge).collect::<Result<Vec<_>, boxline::Error>>()
        },
        |(recording, _), judged| {
            progress.inc(1);
            match judged {
                Ok(judged) => scores.extend(judged),
                Err(e) => broken.push(Broken::of_folder(&recording.folder, e.into())),
            }
            Ok(())
        },
    )?;
    progress.finish_and_clear();
    if scores.is_empty()
        && let Some(first) = broken.pop()
    {
        return Err(first.error); // nothing else is there to tell
    }
    let (mut stdout, mut object) = (String::new(), serde_json::Value::Null);
    if args.json {
        object = tables::json(&scores);
    } else {
        stdout = tables::text(&scores, methods);
    }
    Ok(Broken::finish(&broken, stdout, object))
}
