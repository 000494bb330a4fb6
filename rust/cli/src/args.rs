//! The command line. Help texts here are what a user reads first: each command shows an example.

use crate::workers::Pool;
use boxline::measurement::{LEAST_CONFIDENCE, USUAL_DRIFT_RAD};
use boxline::network::CHANNELS;
use boxline::{EdgeMethod, Error, ErrorKind, Method, Settings};
use boxline_edgenet::{AnyNet, EdgeNet, Options};
#[cfg(feature = "render")]
use boxline_sim::{Hazards, HeadKind, board::Faults, recording::Kind};
use clap::{Arg, Args as ClapArgs, CommandFactory, FromArgMatches, Parser, Subcommand, ValueEnum};
use std::num::NonZeroUsize;
use std::path::PathBuf;

const EXIT_CODES: &str =
    "Exit codes: 0 measured, 2 broken input or usage, 3 refused, 4 two boxes are possible.";

/// Measures boxes from pictures with four laser stripes
#[derive(Parser)]
#[command(
    name = "boxline",
    version,
    after_help = "Exit codes: 2 is broken input or usage in each command; its --help has the others."
)]
pub struct Args {
    #[command(subcommand)]
    pub command: Command,
}

impl Args {
    /// Reads the command line.
    ///
    /// # Errors
    /// What clap says: a usage error, or the help that was asked for.
    pub fn read() -> Result<Self, clap::Error> {
        Self::from_arg_matches(&taking_negative_numbers(Self::command()).try_get_matches()?)
    }
}

/// So that `--length -800` is told what a length is, not that there is no option `-8`.
fn taking_negative_numbers(command: clap::Command) -> clap::Command {
    let takes = |arg: &Arg| !arg.is_positional() && arg.get_action().takes_values();
    let command = command.mut_args(|arg| if takes(&arg) { arg.allow_negative_numbers(true) } else { arg });
    command.mut_subcommands(taking_negative_numbers)
}

#[derive(Subcommand)]
pub enum Command {
    /// Measures a box from two or three frames of adjacent faces
    #[command(after_help = format!("\
Examples:
  boxline measure tests/data/b02 --overlay b02.png
  boxline measure a.jpg b.jpg --calibration calibration.json --json
  boxline measure a.jpg b.jpg c.jpg --calibration calibration.json                      (a third face settles doubts)
  boxline measure tests/data/b02 --explain stages                                       (a picture of each stage)
  boxline measure tests/data/b02 --edges hough --method keypoints --model rust/edgenet/models/ihed.onnx     (the paper's system)

Without --json: sides in mm and the volume in cubic metres, each with one standard deviation, or why there is no result
and what to do. With --json: one object on standard output, also after an error (\"outcome\": \"error\").
{EXIT_CODES}"))]
    Measure(MeasureArgs),
    /// Measures one face from one frame
    #[command(after_help = "\
Example:
  boxline face tests/data/b02/a.jpg --calibration tests/data/calibration_set/calibration.json --overlay face.png

Exit codes: 0 measured, 2 broken input or usage, 3 refused.")]
    Face(FaceArgs),
    /// Compares measurements with the known truth of recordings
    #[command(after_help = "\
Examples:
  boxline evaluate tests/data
  boxline evaluate tests/data/b01 tests/data/refuse --method both --json
  boxline evaluate --edges
  boxline evaluate tests/data --edges --model rust/edgenet/models/boxnet.onnx
  boxline evaluate --simulate 400 --seed 200000000 --photos photos --csv boxes.csv --report accuracy.md
  boxline evaluate --report accuracy.md --csv boxes.csv --csv occluded.csv
  boxline evaluate tests/data --perturb --report accuracy.md
  boxline evaluate tests/data --experiments --out rust/EXPERIMENTS.md --ihed rust/edgenet/models/ihed.onnx

Reads folders that hold recording.json and truth.json, or parents of such folders. A recording whose truth has a box is
measured as a pair of frames; any other recording frame by frame. Measuring where a refusal was due is flagged as WRONG, refusing
where a measurement was due is counted as missed. --simulate measures rendered boxes of materials that training never shows, --experiments
repeats the paper's experiments on rendered twins and keeps each shot in a .csv beside the page: called again, it goes on. --perturb changes
pictures in ways that leave the sizes as they are. --csv keeps one row a side and goes on where a run was stopped; after a change of the
program give another file. Several recordings are measured at a time, as many as there are processors or RAYON_NUM_THREADS says.
Exit codes: 0 the evaluation ran, whatever it found; 2 broken input (the other recordings are told all the same) or usage.")]
    Evaluate(EvaluateArgs),
    /// Calibrates camera and lasers of a head from frames of the circle board
    #[command(after_help = "\
Examples:
  boxline calibrate tests/data/board -o calibration.json --report report.html
  boxline calibrate pictures --board 7x7:37.5:18.75 --camera-only -o camera.json
  boxline calibrate --live --board 12x11:100:50 --keep pictures -o calibration.json

Reads recording.json (frames of role board, lasers on; at least 6, tilted, from near and far) and board.json; without them all JPEGs
of the folder, of the board that --board names. Frames that cannot be used are named with the reason. The calibration in the folder,
if any, is not read. What does not fit is told as a warning: the lens, a bowed or stretched board, a focal length that changes;
but for the lens, the calibration is solved with it.
--live opens a head, says for each frame how many circles are found, where, and which pose is missing, and takes frames by itself.
Exit codes: 0 calibrated, 2 broken input or usage, 3 the frames fix no calibration.")]
    Calibrate(crate::calibrate::CalibrateArgs),
    /// Checks a calibration with one known length
    #[command(after_help = "\
Example:
  boxline verify tests/data/b03 --calibration calibration.json --length 800.0

Exit codes: 0 the length is in, 2 broken input (also a recording without faces) or usage, 3 it is out, or the object could not be measured.")]
    Verify(crate::verify::VerifyArgs),
    /// Converts a calibration's camera to and from OpenCV's model
    #[command(after_help = "\
Examples:
  boxline convert calibration.json --to opencv -o camera.json
  boxline convert calibration.json --from opencv --camera camera.json -o new.json

The distortions run in opposite directions: the camera is refitted over the sensor and what is left is told in px. A lens of
which more than 1 px is left anywhere, as a rule in a corner, is not converted. --from keeps head and laser planes; the covariance
is of the old camera and is not written.
Exit codes: 0 written, 2 broken input or usage, or a lens that the other model cannot have.")]
    Convert(crate::convert::ConvertArgs),
    /// Tells from measurements of ordinary boxes whether the lasers have moved since the calibration
    #[command(after_help = "\
Examples:
  boxline drift box1 box2 box3 box4 box5 --calibration calibration.json
  boxline drift ruler box1 box2 box3 --calibration calibration.json --length 800.0 -o proposed.json

Each face checks the lasers; 20 faces, near and far and tilted differently, see a tilt of 0.2 mrad. Boxes cannot tell a change
of all lengths together; a known length of the first box can. Each frame counts once, however often it is
given. Nothing is written without -o, and never over an input.
Exit codes: 0 no significant change, 2 broken input or usage, or fewer than 3 faces could be measured, 3 the lasers have moved.")]
    Drift(crate::drift::DriftArgs),
    /// Predicts which faces a head can measure from where, and how well
    #[command(after_help = "\
Examples:
  boxline feasibility --calibration calibration.json
  boxline feasibility --calibration calibration.json --face 800x600 --picture sigma.svg

A face beyond 2.5 m that could be seen whole from there is refused as too_far, whatever is predicted for it.
Exit codes: 0 predicted, 2 broken input or usage.")]
    Feasibility(crate::feasibility::FeasibilityArgs),
    /// Lists the cameras on the bus
    #[command(after_help = "\
Example:
  boxline devices --lint

Cameras are only asked for their descriptors: a program that has one keeps it.
Exit codes: 0 listed, also if there is none; 2 the bus cannot be read.")]
    Devices(crate::head::DevicesArgs),
    /// Switches the lasers of a head
    #[command(after_help = "\
Examples:
  boxline laser all --seconds 60
  boxline laser 1,3 --power 40

They are on as long as this runs, and off afterwards, however it ends. Exit codes: 0 done, 2 no head or it failed.")]
    Laser(crate::head::LaserArgs),
    /// Reads or writes what a head has stored
    #[command(after_help = "\
Examples:
  boxline head calibration read -o calibration.json
  boxline head calibration write calibration.json

Exit codes: 0 done, 2 no head, broken file, or it failed.")]
    Head(crate::head::HeadArgs),
    /// Captures a recording from a head
    #[command(after_help = "\
Example:
  boxline capture -o box && boxline measure box

On a terminal each view waits for Enter. A cable that comes out is waited for. The folder appears whole or not at all.
Exit codes: 0 captured, 2 no head or it failed.")]
    Capture(crate::capture::CaptureArgs),
    /// Is a head made of software, for tests without hardware
    #[command(after_help = "\
Examples:
  sudo modprobe vhci-hcd && sudo boxline emulate tests/data/b02
  boxline emulate --render 7 --listen 127.0.0.1:3240

Linux sees a camera, which any program can use. It shows the next view of the recording each time the lasers are lit.
Runs until it is detached.")]
    Emulate(crate::emulate::EmulateArgs),
    /// Renders recordings with known truth, or labelled frames for training
    #[cfg(feature = "render")]
    #[command(after_help = "\
Examples:
  boxline render --out rendered --count 20
  boxline render --out rendered --kind refuse --head nominal --photos photos
  boxline render --stream --seed 1 --photos photos | python train.py
  boxline render --stream --time

A recording of seed 7 is a folder `007` with frames, recording.json, calibration.json and truth.json; it appears whole or not
at all, and none is overwritten. --stream writes labelled frames of 512 x 384 to standard output until the reader goes away.
The same seed gives the same bytes. Exit codes: 0 rendered, 2 broken input or usage.")]
    Render(RenderArgs),
}

#[derive(ClapArgs)]
pub struct MeasureArgs {
    /// A recording's folder, or two or three JPEG frames
    #[arg(required = true, num_args = 1..=3, value_name = "FOLDER | A.jpg B.jpg [C.jpg]")]
    pub inputs: Vec<PathBuf>,
    /// The head's calibration; for a folder it replaces the one that recording.json names
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
    #[command(flatten)]
    pub measuring: MeasureOptions,
    /// The same view as each frame with the lasers off, in the frames' order; a recording's own (`a_off`) are used without it
    #[arg(long, value_name = "A_OFF.jpg", conflicts_with = "ignore_off")]
    pub off: Vec<PathBuf>,
    /// Do not use a recording's views with the lasers off
    #[arg(long)]
    pub ignore_off: bool,
    /// If all frames show sides of the same two lengths, two boxes are possible: take the first or the second
    #[arg(long, value_name = "1|2", value_parser = clap::value_parser!(u8).range(1..=2))]
    pub choose: Option<u8>,
    /// Draw what each stage finds, a picture a stage and frame, into a new folder
    #[arg(long, value_name = "FOLDER")]
    pub explain: Option<PathBuf>,
    #[command(flatten)]
    pub output: Output,
}

#[derive(ClapArgs)]
pub struct FaceArgs {
    /// A JPEG frame
    #[arg(value_name = "A.jpg")]
    pub frame: PathBuf,
    /// The head's calibration
    #[arg(long, value_name = "FILE")]
    pub calibration: PathBuf,
    #[command(flatten)]
    pub measuring: MeasureOptions,
    #[command(flatten)]
    pub output: Output,
}

#[derive(ClapArgs)]
pub struct EvaluateArgs {
    /// Recordings with truth.json, or folders of such recordings; `--edges` alone needs none
    #[arg(value_name = "FOLDER")]
    pub folders: Vec<PathBuf>,
    /// Replaces the calibration that each recording.json names
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
    /// How sides are computed; `both` shows the paper's way beside the fit
    #[arg(long, value_enum, default_value_t = EvaluateMethod::Fit)]
    pub method: EvaluateMethod,
    /// How the edges of the face are found. Without a name, nothing is measured but the network's maps are scored, on the
    /// folders' frames or, if there are none, on rendered ones
    #[arg(long, value_enum, value_name = "NAME")]
    pub edges: Option<Option<EdgeName>>,
    #[command(flatten)]
    pub network: NetworkArgs,
    /// Do not use views with the lasers off that recordings have
    #[arg(long)]
    pub ignore_off: bool,
    /// Use at most so many frames of each box
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u8).range(2..=3))]
    pub faces: u8,
    /// Rendered frames to score
    #[arg(long, value_name = "N", default_value_t = 1500, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    pub frames: u64,
    /// JPEGs for the textures of rendered frames (rust/edgenet/training/photos.sh fills a folder)
    #[arg(long, value_name = "FOLDER")]
    pub photos: Option<PathBuf>,
    /// Measure so many rendered recordings, one a seed: the same as `render --held-out` writes, of one face if it is not of a box
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1_000_000), conflicts_with_all = ["folders", "calibration", "experiments"])]
    pub simulate: Option<u64>,
    /// What --simulate renders
    #[cfg(feature = "render")]
    #[arg(long, value_enum, default_value_t = RenderKind::Box)]
    pub kind: RenderKind,
    /// Render each view with the lasers off too, 1/15 s later
    #[cfg(feature = "render")]
    #[arg(long, requires = "simulate", conflicts_with = "ignore_off")]
    pub off: bool,
    /// What may make the rendered ones hard to measure: all, none, or names with commas between them
    #[cfg(feature = "render")]
    #[arg(long, value_name = "LIST", default_value = "all", value_parser = Hazards::parse)]
    pub hazards: Hazards,
    /// Keep one row a side in this file, and go on with what is not there yet
    #[arg(long, value_name = "FILE", conflicts_with = "experiments")]
    pub csv: Vec<PathBuf>,
    /// Write a page about all rows of the file (.md), its pictures beside it in docs/; without anything to measure, of several --csv
    #[arg(long, value_name = "PAGE", conflicts_with = "experiments")]
    pub report: Option<PathBuf>,
    /// A sentence for the head of the page: what the seeds were used for before
    #[arg(long, value_name = "TEXT", requires = "report")]
    pub note: Option<String>,
    /// Draw every wrong result with the truth, a picture each
    #[arg(long, value_name = "FOLDER", conflicts_with = "experiments")]
    pub overlays: Option<PathBuf>,
    /// Repeat the paper's experiments on rendered twins and, if they are given, on recordings; needs --out
    #[arg(long, requires = "out", conflicts_with_all = ["calibration", "method", "edges"])]
    pub experiments: bool,
    /// The page that --experiments writes (.md); its picture (.svg) and the shots (.csv) go beside it
    #[arg(long, value_name = "FILE", requires = "experiments")]
    pub out: Option<PathBuf>,
    /// At most so many shots of each pose and box in --experiments; without it as many as the paper: 30, 15 or 10
    #[arg(long, value_name = "N", requires = "experiments", value_parser = clap::value_parser!(u64).range(1..=10_000))]
    pub shots: Option<u64>,
    /// The paper's own network (HED, IHED; .onnx) for a column of --experiments
    #[arg(long, value_name = "FILE", requires = "experiments")]
    pub ihed: Option<PathBuf>,
    /// Measure each recording again after changes that leave the sizes as they are: JPEG quality, light, noise, blur, bars, a date,
    /// paint on the face. Tells by how many sigmas sides move and what becomes wrong; --csv, --report (a section) and --overlays are its own
    #[arg(long, conflicts_with_all = ["simulate", "experiments"])]
    pub perturb: bool,
    /// Seed of --simulate, --experiments and the noise of --perturb
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

#[cfg(feature = "render")]
#[derive(ClapArgs)]
pub struct RenderArgs {
    /// Folder for the recordings
    #[arg(long, value_name = "FOLDER", required_unless_present = "stream")]
    pub out: Option<PathBuf>,
    /// Seed of the first recording or frame; the next ones count on
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// How many; without it one recording, or frames without end
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..=1_000_000_000))]
    pub count: Option<u64>,
    /// Two or three faces of one box, single faces, frames that must be refused, or faces that something hides in part
    #[arg(long, value_enum, default_value_t = RenderKind::Box)]
    pub kind: RenderKind,
    /// Frames of a recording that is not of a box
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = frames_per_recording)]
    pub frames: usize,
    /// Add each view with the lasers off, 1/15 s later: the hand that holds the head has moved a little
    #[arg(long)]
    pub off: bool,
    /// The head does not move before the view with the lasers off
    #[arg(long, requires = "off")]
    pub still: bool,
    /// A head as production scatters it, the paper's, or one with a lens that is not centred and has an r^6 term
    #[arg(long, value_enum, default_value_t = HeadName::Random)]
    pub head: HeadName,
    /// What is wrong with a board and the head that sees it: the focal length changes between frames by a share (1 sigma), the board bows
    /// by mm, its columns' pitch is larger by a share, a share of the light comes from one side, the sensor is tilted by degrees
    #[arg(long, value_name = "focus=0.003,bow=2,stretch=0.001,light=0.8,tilt=0.3", default_value = "", hide_default_value = true, value_parser = Faults::parse)]
    pub faults: Faults,
    /// JPEGs for prints, posters and walls (rust/edgenet/training/photos.sh fills a folder)
    #[arg(long, value_name = "FOLDER")]
    pub photos: Option<PathBuf>,
    /// Draw materials and photographs that training never shows
    #[arg(long)]
    pub held_out: bool,
    /// What may make boxes hard to measure: all, none, or names with commas between them
    #[arg(long, value_name = "LIST", default_value = "all", value_parser = Hazards::parse)]
    pub hazards: Hazards,
    /// Write labelled frames to standard output instead (format boxline-stream/1)
    #[arg(long, conflicts_with_all = ["out", "kind", "frames", "off", "head"])]
    pub stream: bool,
    /// With --stream: faces in their own plane with the places of their sides (format boxline-views/1)
    #[arg(long, requires = "stream", conflicts_with = "time")]
    pub views: bool,
    /// Only say how fast --stream is
    #[arg(long, requires = "stream", conflicts_with = "out")]
    pub time: bool,
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

#[cfg(feature = "render")]
fn frames_per_recording(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|n| (1..=1000).contains(n)).ok_or_else(|| "1 to 1000 frames".to_owned())
}

#[cfg(feature = "render")]
#[derive(Clone, Copy, ValueEnum)]
pub enum RenderKind {
    /// Two adjacent faces of one box
    Box,
    /// Three adjacent faces of one box
    Three,
    /// A box A x A x B, seen obliquely: both frames show A x B
    Twins,
    /// Single faces, one a frame
    Face,
    /// Frames that must be refused: cut faces, missing stripes, no box
    Refuse,
    /// Faces of which something hides a part; they must be refused
    Occluded,
    /// Frames of the circle board, for `boxline calibrate`
    Board,
}

#[cfg(feature = "render")]
impl RenderKind {
    /// The renderer's name for it; `frames` of a recording that is not of a box.
    pub const fn of(self, frames: usize) -> Kind {
        match self {
            Self::Box => Kind::Box,
            Self::Three => Kind::Three,
            Self::Twins => Kind::Twins,
            Self::Face => Kind::Faces(frames),
            Self::Refuse => Kind::Refuse(frames),
            Self::Occluded => Kind::Occluded(frames),
            Self::Board => Kind::Board(frames),
        }
    }
}

#[cfg(feature = "render")]
#[derive(Clone, Copy, ValueEnum)]
pub enum HeadName {
    /// Drawn: camera, lens and lasers as heads differ
    Random,
    /// The paper's, without errors of making
    Nominal,
    /// Drawn, with a lens that is decentred and has a third radial term
    Real,
}

#[cfg(feature = "render")]
impl HeadName {
    pub const fn kind(self) -> HeadKind {
        match self {
            Self::Random => HeadKind::Random,
            Self::Nominal => HeadKind::Nominal,
            Self::Real => HeadKind::Real,
        }
    }
}

#[derive(ClapArgs)]
pub struct MeasureOptions {
    /// How sides are computed: joint fit of a rectangle, or the paper's eight key points
    #[arg(long, value_enum, default_value_t = MethodName::Fit)]
    pub method: MethodName,
    /// How the edges of the face are found: where the network sees them, where the stripes end, or by the paper's Hough
    /// transform on the network's map
    #[arg(long, value_enum, default_value_t)]
    pub edges: EdgeName,
    /// How far each laser may have turned since the calibration (1 sigma); it is in every sigma
    #[arg(long, value_name = "MRAD", default_value_t = USUAL_DRIFT_RAD * 1e3, value_parser = drift_mrad)]
    pub drift_mrad: f64,
    /// Do not impose right angles: the corners' angles are measured and printed
    #[arg(long)]
    pub free: bool,

    #[command(flatten)]
    pub network: NetworkArgs,
}

/// 10 mrad is half a degree: a laser that turned by more is broken, not drifting.
fn drift_mrad(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|d| (0.0..=10.0).contains(d)).ok_or_else(|| "0 to 10 mrad".to_owned())
}

#[derive(ClapArgs)]
pub struct Output {
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
    /// Write a picture that shows what was found (.png or .jpg)
    #[arg(long, value_name = "FILE")]
    pub overlay: Option<PathBuf>,
}

#[derive(Clone, Copy, ValueEnum)]
pub enum MethodName {
    Fit,
    Keypoints,
}

#[derive(Clone, Copy, ValueEnum)]
pub enum EvaluateMethod {
    Fit,
    Keypoints,
    Both,
}

#[derive(Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum EdgeName {
    #[default]
    Net,
    Gradient,
    Hough,
}

/// Which network, how it runs, and how sure it must be.
#[derive(ClapArgs)]
pub struct NetworkArgs {
    /// Use this network instead of the one that ships (.onnx): one of nine maps or, with --edges hough, one of the paper's kind
    /// (HED, IHED), which gives a single map
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Threads of the network. It runs on ONNX Runtime if its library is beside the program or ORT_DYLIB_PATH names it, else inside
    #[arg(long, value_name = "N", value_parser = threads)]
    pub threads: Option<NonZeroUsize>,
    /// Refuse what is less likely to be right than this, 0 to 1; rust/ACCURACY.md has the curve
    #[arg(long, value_name = "P", default_value_t = LEAST_CONFIDENCE, value_parser = probability)]
    pub least_confidence: f64,
}

/// More threads than this spend their time waiting for each other; thousands never end.
const MOST_THREADS: usize = 64;

fn threads(text: &str) -> Result<NonZeroUsize, String> {
    let count = text.parse().ok().filter(|n: &NonZeroUsize| n.get() <= MOST_THREADS);
    count.ok_or_else(|| format!("1 to {MOST_THREADS} threads"))
}

fn probability(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|p| (0.0..=1.0).contains(p)).ok_or_else(|| "0 to 1".to_owned())
}

impl NetworkArgs {
    /// Loads the network if this way of finding edges needs one.
    pub fn load(&self, edges: EdgeName) -> Result<Option<AnyNet>, Error> {
        let net = match (edges, &self.model) {
            (EdgeName::Gradient, _) => return Ok(None),
            (_, Some(path)) => AnyNet::from_path(path, &self.options())?,
            (_, None) => AnyNet::Face(Box::new(EdgeNet::embedded(&self.options())?)),
        };
        if let (EdgeName::Net, AnyNet::EdgeMap(_), Some(path)) = (edges, &net, &self.model) {
            let text = format!(
                "{}: the network gives the paper's one map, which --edges hough works with; --edges net needs {CHANNELS} maps",
                path.display()
            );
            return Err(Error::new(ErrorKind::ModelFile, text));
        }
        Ok(Some(net))
    }

    /// The same where several run side by side: one thread each unless told otherwise.
    pub fn load_one_of_many(&self, edges: EdgeName) -> Result<Option<AnyNet>, Error> {
        let threads = Some(self.threads.unwrap_or(NonZeroUsize::MIN));
        Self { model: self.model.clone(), threads, ..*self }.load(edges)
    }

    /// Loads the network of nine maps.
    pub fn load_anyway(&self) -> Result<EdgeNet, Error> {
        match &self.model {
            Some(path) => EdgeNet::from_path(path, &self.options()),
            None => EdgeNet::embedded(&self.options()),
        }
    }

    /// The library's settings for a way to measure with a network that was loaded so.
    pub fn settings<'a>(&self, method: Method, edges: EdgeName, network: Option<&'a AnyNet>) -> Settings<'a> {
        Settings {
            method,
            edges: edges.into(),
            network: network.and_then(AnyNet::network),
            edge_map: network.and_then(AnyNet::edge_map),
            least_confidence: self.least_confidence,
            ..Settings::default()
        }
    }

    /// How networks are run.
    pub fn options(&self) -> Options {
        let mut options = Options::default();
        options.threads = self.threads.unwrap_or(options.threads);
        options
    }
}

impl MeasureOptions {
    /// The library's settings.
    pub fn settings<'a>(&self, choose: Option<u8>, network: Option<&'a AnyNet>) -> Settings<'a> {
        let method = match self.method {
            MethodName::Fit => Method::Fit,
            MethodName::Keypoints => Method::Keypoints,
        };
        Settings {
            choose: choose.map(|number| usize::from(number).saturating_sub(1)),
            workers: Some(&Pool),
            drift_rad: self.drift_mrad * 1e-3,
            free: self.free,
            ..self.network.settings(method, self.edges, network)
        }
    }
}

impl From<EdgeName> for EdgeMethod {
    fn from(name: EdgeName) -> Self {
        match name {
            EdgeName::Net => Self::Net,
            EdgeName::Gradient => Self::Gradient,
            EdgeName::Hough => Self::Hough,
        }
    }
}

impl EvaluateMethod {
    /// The methods to run, the product's own first.
    pub fn methods(self) -> &'static [Method] {
        match self {
            Self::Fit => &[Method::Fit],
            Self::Keypoints => &[Method::Keypoints],
            Self::Both => &[Method::Fit, Method::Keypoints],
        }
    }
}
