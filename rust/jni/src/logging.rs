//! The log: Android's own under the tag `boxline`, elsewhere standard error. Panics go there with their place, since the
//! exception that Java sees has only the text.

use log::LevelFilter;
use std::sync::Once;

static STARTED: Once = Once::new();

/// Starts the log, once per process; `level`: 0 off, 1 errors, 2 warnings, 3 information, 4 details. A later call only
/// changes the level.
pub(crate) fn start(level: i32) {
    let filter = match level {
        ..=0 => LevelFilter::Off,
        1 => LevelFilter::Error,
        2 => LevelFilter::Warn,
        3 => LevelFilter::Info,
        _ => LevelFilter::Debug,
    };
    STARTED.call_once(|| {
        start_backend();
        let before = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            log::error!("{panic}");
            if cfg!(not(target_os = "android")) {
                before(panic);
            }
        }));
    });
    log::set_max_level(filter);
}

#[cfg(target_os = "android")]
fn start_backend() {
    let config = android_logger::Config::default().with_tag("boxline").with_max_level(LevelFilter::Debug);
    android_logger::init_once(config);
}

#[cfg(not(target_os = "android"))]
fn start_backend() {
    // Fails only if the program around has a log already, which is as good.
    log::set_logger(&StandardError).ok();
}

// Eight lines here instead of env_logger: that one turns on features of `log` for everything that is built with it.
#[cfg(not(target_os = "android"))]
struct StandardError;

#[cfg(not(target_os = "android"))]
impl log::Log for StandardError {
    fn enabled(&self, _: &log::Metadata<'_>) -> bool {
        true // the level is looked at before
    }

    fn log(&self, record: &log::Record<'_>) {
        eprintln!("boxline {}: {}", record.level(), record.args());
    }

    fn flush(&self) {}
}
