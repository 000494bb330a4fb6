//! `boxline calibrate --live`: somebody moves the board before a head; which frames are worth taking, core's `Session` says. Here are the
//! loop, the head, the files and what is shown.

use super::CalibrateArgs;
use super::input::{BoardFrame, jpegs_of};
use crate::capture::{BACK_WITHIN, Camera, may_come_back, reopen};
use crate::input::read_frame;
use crate::say::say;
use anyhow::Context;
use boxline::{Frame, Px};
use boxline_calib::{Board, BoardView, Session, Verdict, find_board};
use boxline_uvc::Selector;
use boxline_uvc::head::{self, Lasers};
use indicatif::{ProgressBar, ProgressStyle};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// So long the lasers are off after a frame was taken: whoever holds the board sees it.
const BLINK: Duration = Duration::from_millis(400);
/// The map of the picture on a terminal, characters.
const MAP: [usize; 2] = [48, 14];

/// Where pictures come from.
pub trait Pictures {
    /// The next JPEG; `None` if there are no more.
    fn next(&mut self) -> anyhow::Result<Option<Vec<u8>>>;
    /// One was taken.
    fn taken(&mut self) -> anyhow::Result<()>;
}

/// A head on the cable.
struct HeadPictures {
    camera: Option<Camera>,
    same: Selector,
    lasers: Lasers,
}

impl HeadPictures {
    fn camera(&self) -> anyhow::Result<&Camera> {
        self.camera.as_ref().context("the head is gone")
    }
}

impl Pictures for HeadPictures {
    fn next(&mut self) -> anyhow::Result<Option<Vec<u8>>> {
        loop {
            match self.camera()?.frame(self.lasers, &ProgressBar::hidden()) {
                Ok(frame) => return Ok(Some(frame.jpeg)),
                Err(e) if may_come_back(&e) => {
                    say(&format!("note: {e}; waiting for the head"));
                    // Closed before it is opened again, so that the new one finds the interfaces free.
                    self.camera = None;
                    self.camera = Some(reopen(&self.same, BACK_WITHIN, e)?);
                }
                Err(e) => return Err(e.into()),
            }
        }
    }

    fn taken(&mut self) -> anyhow::Result<()> {
        self.camera()?.device.set_lasers(Lasers::OFF)?;
        std::thread::sleep(BLINK);
        Ok(())
    }
}

/// What is seen of one frame.
pub struct LiveFrame {
    /// Circles, where they are, how the board stands, and what becomes of the frame.
    pub text: String,
    /// Where circles are now, if the board was found.
    pub circles: Vec<Px>,
    /// Of the file, if it was taken.
    pub kept: Option<String>,
}

/// Frames that are taken until nothing is missing.
pub struct LiveCapture<'a> {
    pub session: Session,
    board: &'a Board,
    folder: &'a Path,
    /// Stop at so many, whatever is missing or not.
    most: Option<usize>,
}

impl<'a> LiveCapture<'a> {
    /// Those that are in the folder count.
    pub fn new(board: &'a Board, folder: &'a Path, most: Option<usize>) -> anyhow::Result<Self> {
        let mut session = Session::new(*board);
        for BoardFrame { id, file } in jpegs_of(folder)? {
            // `calibrate` says it once more, with all others.
            match read_frame(&file).map(|frame| find_board(&frame, board)) {
                Ok(Ok(view)) if session.take(view.clone()) => {}
                Ok(Ok(_)) => say(&format!("note: {id} does not count: its circles lie on no plane")),
                Ok(Err(why)) => say(&format!("note: {id} does not count: {why}")),
                Err(why) => say(&format!("note: {id} does not count: {why}")),
            }
        }
        Ok(Self { session, board, folder, most })
    }

    fn enough(&self) -> bool {
        self.most.map_or_else(|| self.session.missing().is_empty(), |most| self.session.taken() >= most)
    }

    /// Takes frames until it is enough, there are no more, or `stop` is set.
    pub fn run(
        &mut self,
        pictures: &mut impl Pictures,
        stop: &AtomicBool,
        mut tell: impl FnMut(&LiveFrame, &Session),
    ) -> anyhow::Result<()> {
        let mut before = None;
        while !self.enough() && !stop.load(Ordering::Relaxed) {
            let Some(jpeg) = pictures.next()? else { break };
            let (look, view) = self.look(&jpeg, before.as_ref())?;
            tell(&look, &self.session);
            if look.kept.is_some() {
                pictures.taken()?;
            }
            before = view;
        }
        Ok(())
    }

    fn look(
        &mut self,
        jpeg: &[u8],
        before: Option<&BoardView>,
    ) -> anyhow::Result<(LiveFrame, Option<BoardView>)> {
        let nothing = |text: String| Ok((LiveFrame { text, circles: Vec::new(), kept: None }, None));
        let frame = match Frame::from_jpeg(jpeg) {
            Ok(frame) => frame,
            Err(why) => return nothing(why.to_string()),
        };
        let view = match find_board(&frame, self.board) {
            Ok(view) => view,
            Err(why) => return nothing(why.to_string()),
        };
        let verdict = self.session.judge(&view, before);
        let kept = if verdict == Verdict::Take { Some(self.keep(jpeg)?) } else { None };
        let text = format!("{}: {}", self.seen(&view), verdict_text(verdict, kept.as_deref()));
        let circles = view.circles.iter().map(|c| c.ellipse_centre).collect();
        if kept.is_some() {
            self.session.take(view.clone());
        }
        Ok((LiveFrame { text, circles, kept }, Some(view)))
    }

    /// Writes a picture under the next free number; it appears whole or not at all.
    fn keep(&self, jpeg: &[u8]) -> anyhow::Result<String> {
        let folder = || self.folder.display().to_string();
        let mut file = tempfile::NamedTempFile::new_in(self.folder).with_context(folder)?;
        file.write_all(jpeg).with_context(folder)?;
        let free = (1..).map(|n| format!("live-{n:03}.jpg")).find(|name| !self.folder.join(name).exists());
        let name = free.context("no number is free")?;
        file.persist_noclobber(self.folder.join(&name)).with_context(folder)?;
        Ok(name)
    }

    fn seen(&self, view: &BoardView) -> String {
        let all = (self.board.columns * self.board.rows) as usize;
        let range = |of: fn(Px) -> f64| {
            let each = view.circles.iter().map(|c| of(c.ellipse_centre));
            each.fold((f64::INFINITY, 0.0f64), |(low, high), x| (low.min(x), high.max(x)))
        };
        let ((left, right), (top, bottom)) = (range(|px| px.u), range(|px| px.v));
        let found = view.circles.len();
        let mut text = format!(
            "{found} of {all} circles ({:.0} %), u {left:.0} to {right:.0} of {}, v {top:.0} to {bottom:.0} of {}",
            100.0 * found as f64 / all as f64,
            view.width_px,
            view.height_px
        );
        if let Some(place) = self.session.place(view) {
            text += &format!(
                ", at {:.0} mm, {:.0} degrees towards {}",
                place.distance_mm, place.tilt_deg, place.towards
            );
        }
        text
    }
}

fn verdict_text(verdict: Verdict, kept: Option<&str>) -> String {
    match verdict {
        Verdict::Take => format!("taken as {}", kept.unwrap_or_default()),
        Verdict::Moving { shift_px: Some(px) } => format!("it moves by {px:.0} px, hold still"),
        Verdict::Moving { shift_px: None } => "hold still".into(),
        Verdict::Known => "this pose is there already".into(),
        Verdict::OtherSize => "another size than the frames before".into(),
        Verdict::Unplaced => "its circles lie on no plane".into(),
    }
}

/// What is missing, in words.
pub fn missing_text(session: &Session) -> String {
    let missing: Vec<String> = session.missing().iter().map(ToString::to_string).collect();
    let taken = session.taken();
    if missing.is_empty() {
        format!("{taken} frames, nothing is missing")
    } else {
        format!("{taken} frames, missing: {}", missing.join("; "))
    }
}

/// The picture in characters: where circles are now (`O`), and where there were some in frames that were taken (`+`).
fn map(look: &LiveFrame, session: &Session) -> String {
    let [columns, rows] = MAP;
    let Some([width, height]) = session.image_px() else { return String::new() };
    let mut cells = vec![b'.'; columns * rows];
    let mut mark = |px: Px, with: u8| {
        let cell =
            |x: f64, size: usize, n: usize| ((x / size as f64 * n as f64).max(0.0) as usize).min(n - 1);
        cells[cell(px.v, height, rows) * columns + cell(px.u, width, columns)] = with;
    };
    session.circles().for_each(|px| mark(px, b'+'));
    look.circles.iter().for_each(|px| mark(*px, b'O'));
    cells.chunks(columns).map(|row| format!("\n  {}", String::from_utf8_lossy(row))).collect()
}

/// The folder where frames are, and the head's serial number.
pub struct CapturedFolder {
    pub folder: PathBuf,
    pub serial: String,
    /// Gone with this, if frames are not to be kept.
    pub temporary: Option<tempfile::TempDir>,
    pub count: usize,
}

/// Opens the head and takes frames.
pub fn take(args: &CalibrateArgs, board: &Board) -> anyhow::Result<CapturedFolder> {
    let camera = Camera::open(&args.choice.device.clone().unwrap_or_default())?;
    let serial = head::serial(&camera.device)?;
    let same = Selector { serial: Some(camera.device.serial().to_owned()), ..Selector::default() };
    let temporary = if args.keep.is_none() { Some(tempfile::tempdir()?) } else { None };
    let folder = match (&args.keep, &temporary) {
        (Some(folder), _) => folder.clone(),
        (_, temporary) => temporary.as_ref().map(|t| t.path().to_owned()).unwrap_or_default(),
    };
    std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
    let mut taking = LiveCapture::new(board, &folder, args.frames.map(usize::from))?;
    let stop = Arc::new(AtomicBool::new(false));
    let asked = Arc::clone(&stop);
    // The first one ends the taking, the second the program.
    ctrlc::set_handler(move || {
        if asked.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
    })?;
    let lasers = if args.camera_only { Lasers::OFF } else { Lasers::ALL };
    let mut pictures = HeadPictures { camera: Some(camera), same, lasers };
    let bar = ProgressBar::new_spinner().with_style(ProgressStyle::with_template("{msg}")?);
    say(&missing_text(&taking.session));
    taking.run(&mut pictures, &stop, |look, session| {
        let line = format!("{}\n{}", look.text, missing_text(session));
        if look.kept.is_some() {
            bar.suspend(|| say(&line));
        }
        bar.set_message(line + &map(look, session));
        bar.tick();
    })?;
    bar.finish_and_clear();
    let count = taking.session.taken();
    Ok(CapturedFolder { folder, serial, temporary, count })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::VecDeque;

    const BOARD: Board = Board { columns: 12, rows: 11, pitch_mm: 100.0, diameter_mm: 50.0 };

    /// Recorded frames, each shown so often.
    struct Recorded {
        frames: VecDeque<Vec<u8>>,
        taken: usize,
    }

    impl Recorded {
        fn new(names: &[&str], times: usize) -> Self {
            let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/board");
            let read = |name: &&str| std::fs::read(folder.join(format!("{name}.jpg"))).unwrap();
            let frames = names.iter().flat_map(|name| vec![read(name); times]).collect();
            Self { frames, taken: 0 }
        }
    }

    impl Pictures for Recorded {
        fn next(&mut self) -> anyhow::Result<Option<Vec<u8>>> {
            Ok(self.frames.pop_front())
        }

        fn taken(&mut self) -> anyhow::Result<()> {
            self.taken += 1;
            Ok(())
        }
    }

    fn run(taking: &mut LiveCapture<'_>, pictures: &mut Recorded) -> Vec<LiveFrame> {
        let mut looks = Vec::new();
        let tell = |look: &LiveFrame, _: &Session| {
            let (text, circles, kept) = (look.text.clone(), look.circles.clone(), look.kept.clone());
            looks.push(LiveFrame { text, circles, kept });
        };
        taking.run(pictures, &AtomicBool::new(false), tell).unwrap();
        looks
    }

    fn files(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = std::fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn frames_are_taken_when_the_board_holds_still_in_a_new_pose() {
        let folder = tempfile::tempdir().unwrap();
        let mut taking = LiveCapture::new(&BOARD, folder.path(), None).unwrap();
        // Three poses, each shown three times, one that is there already, and a picture that is none.
        let mut pictures = Recorded::new(&["c01", "c05", "c09", "c01"], 3);
        pictures.frames.push_back(b"no picture".to_vec());
        let looks = run(&mut taking, &mut pictures);
        let kept: Vec<usize> = (0..looks.len()).filter(|i| looks[*i].kept.is_some()).collect();
        assert_eq!(kept, [1, 4, 7], "{:?}", looks.iter().map(|l| &l.text).collect::<Vec<_>>());
        assert!(looks[0].text.contains("hold still"), "{}", looks[0].text);
        assert!(
            looks[1].text.contains(" of 132 circles") && looks[1].text.ends_with("taken as live-001.jpg")
        );
        assert!(looks[2].text.ends_with("this pose is there already"), "{}", looks[2].text);
        assert!(looks[11].text.ends_with("this pose is there already") && looks[12].circles.is_empty());
        assert_eq!(
            (pictures.taken, files(folder.path())),
            (3, ["001", "002", "003"].map(|n| format!("live-{n}.jpg")).to_vec())
        );
        assert_eq!(map(&looks[1], &taking.session).lines().count(), 1 + MAP[1]);
        assert!(map(&looks[1], &taking.session).contains('O'));
        assert!(missing_text(&taking.session).starts_with("3 frames, missing: "));

        // What is there counts: one more, and four are enough.
        let mut taking = LiveCapture::new(&BOARD, folder.path(), Some(4)).unwrap();
        assert_eq!(taking.session.taken(), 3);
        let mut pictures = Recorded::new(&["c05", "c13", "c21"], 2);
        run(&mut taking, &mut pictures);
        assert_eq!((taking.session.taken(), pictures.frames.len()), (4, 2));
        assert_eq!(files(folder.path()).last().unwrap(), "live-004.jpg");
    }

    #[test]
    fn a_stop_ends_it_before_the_next_frame() {
        let folder = tempfile::tempdir().unwrap();
        let mut taking = LiveCapture::new(&BOARD, folder.path(), None).unwrap();
        let mut pictures = Recorded::new(&["c01"], 2);
        taking.run(&mut pictures, &AtomicBool::new(true), |_, _| panic!("nothing is looked at")).unwrap();
        assert_eq!((pictures.frames.len(), files(folder.path()).len()), (2, 0));
    }
}
