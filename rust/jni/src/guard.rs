//! The wall between Rust and the JVM: every native function runs inside [`guard`], and every failure leaves as a Java
//! exception of a type that says whose fault it was.

use crate::handles::NotOpen;
use boxline::ErrorKind;
use jni::errors::ErrorPolicy;
use jni::objects::{JThrowable, JValue};
use jni::strings::{JNIStr, JNIString};
use jni::{Env, EnvUnowned, jni_sig, jni_str};
use std::any::Any;

/// Why a native function failed.
#[derive(Debug)]
pub(crate) enum Failure {
    /// A broken input.
    Boxline(boxline::Error),
    /// A handle that is not open.
    Handle(String),
    /// An argument that is null.
    Null(&'static str),
    /// An argument that can never be right.
    Argument(String),
    /// The head, or the way to it, failed.
    Device(boxline_uvc::Error),
    /// The caller asked to stop.
    Cancelled,
    /// A call into the JVM failed; mostly a Java exception is pending then.
    Jni(jni::errors::Error),
}

impl From<NotOpen> for Failure {
    fn from(NotOpen(text): NotOpen) -> Self {
        Self::Handle(text)
    }
}

impl From<boxline::Error> for Failure {
    fn from(e: boxline::Error) -> Self {
        if e.kind() == ErrorKind::Cancelled { Self::Cancelled } else { Self::Boxline(e) }
    }
}

impl From<boxline_uvc::Error> for Failure {
    fn from(e: boxline_uvc::Error) -> Self {
        Self::Device(e)
    }
}

impl From<jni::errors::Error> for Failure {
    fn from(e: jni::errors::Error) -> Self {
        Self::Jni(e)
    }
}

const NATIVE_BUG: &JNIStr = jni_str!("dev/boxline/NativeBugException");
const CONFIG: &JNIStr = jni_str!("dev/boxline/ScannerConfigException");
const DEVICE: &JNIStr = jni_str!("dev/boxline/DeviceException");

impl Failure {
    /// The exception's class and text.
    fn exception(&self) -> (&'static JNIStr, String) {
        match self {
            Self::Boxline(e) => (class_of(e.kind()), e.to_string()),
            Self::Handle(text) => (jni_str!("java/lang/IllegalStateException"), text.clone()),
            Self::Null(name) => (jni_str!("java/lang/NullPointerException"), format!("{name} is null")),
            Self::Argument(text) => (jni_str!("java/lang/IllegalArgumentException"), text.clone()),
            Self::Device(e) => (class_of_device(e.kind()), e.to_string()),
            Self::Cancelled => {
                (jni_str!("java/util/concurrent/CancellationException"), "cancelled".to_owned())
            }
            Self::Jni(e) => (NATIVE_BUG, format!("a call into the JVM failed: {e}")),
        }
    }
}

fn class_of(kind: ErrorKind) -> &'static JNIStr {
    match kind {
        ErrorKind::InvalidCalibration
        | ErrorKind::CalibrationMismatch
        | ErrorKind::ModelFile
        | ErrorKind::NetworkRuntime
        | ErrorKind::InvalidFile
        | ErrorKind::Io => CONFIG,
        ErrorKind::InvalidFrame => jni_str!("dev/boxline/InvalidFrameException"),
        // Only a recording touches files; any other kind is our mistake.
        _ => NATIVE_BUG,
    }
}

/// A head without a calibration is set up wrongly; everything else about it may pass, so it has one class, and the name of its kind in
/// front of the text.
fn class_of_device(kind: boxline_uvc::ErrorKind) -> &'static JNIStr {
    match kind {
        boxline_uvc::ErrorKind::Store => CONFIG,
        _ => DEVICE,
    }
}

/// The names of `dev.boxline.DeviceCause`.
fn device_cause(kind: boxline_uvc::ErrorKind) -> &'static str {
    use boxline_uvc::ErrorKind as Kind;
    match kind {
        Kind::DeviceLost | Kind::NotFound => "LOST",
        Kind::DeviceBusy => "BUSY",
        Kind::PermissionDenied => "PERMISSION",
        Kind::Timeout => "SILENT",
        Kind::Bandwidth => "BANDWIDTH",
        Kind::Unsupported | Kind::Descriptor => "NOT_A_HEAD",
        Kind::Refused | Kind::Protocol | Kind::InvalidArgument => "PROTOCOL",
        _ => "USB",
    }
}

/// Runs the body of a native function. A failure or a panic becomes a pending Java exception and the default value.
pub(crate) fn guard<'local, T: Default>(
    mut env: EnvUnowned<'local>,
    body: impl FnOnce(&mut Env<'local>) -> Result<T, Failure>,
) -> T {
    env.with_env(body).resolve::<Throw>()
}

struct Throw;

impl<T: Default> ErrorPolicy<T, Failure> for Throw {
    type Captures<'frame: 'method, 'method> = ();

    fn on_error<'frame: 'method, 'method>(
        env: &mut Env<'frame>,
        (): &mut (),
        failure: Failure,
    ) -> jni::errors::Result<T> {
        if !env.exception_check() {
            if let Failure::Device(e) = &failure
                && class_of_device(e.kind()) == DEVICE
            {
                throw_device(env, e)?;
            } else {
                let (class, text) = failure.exception();
                throw(env, class, &text)?;
            }
        }
        Ok(T::default())
    }

    fn on_panic<'frame: 'method, 'method>(
        env: &mut Env<'frame>,
        (): &mut (),
        payload: Box<dyn Any + Send>,
    ) -> jni::errors::Result<T> {
        env.exception_clear(); // the panic is what matters
        throw(env, NATIVE_BUG, &format!("panic in native code: {}", panic_text(payload)))?;
        Ok(T::default())
    }
}

fn throw(env: &mut Env<'_>, class: &JNIStr, text: &str) -> jni::errors::Result<()> {
    // The caller's class loader, so that an app's own classes are found.
    let class = env.find_class(class)?;
    match env.throw_new(class, JNIString::from(text)) {
        Err(jni::errors::Error::JavaException) => Ok(()), // that is how success looks
        other => other,
    }
}

fn throw_device(env: &mut Env<'_>, error: &boxline_uvc::Error) -> jni::errors::Result<()> {
    let class = env.find_class(DEVICE)?;
    let cause = env.new_string(device_cause(error.kind()))?;
    let text = env.new_string(error.to_string())?;
    let arguments = [JValue::Object(&cause), JValue::Object(&text)];
    let exception = env.new_object(class, jni_sig!("(Ljava/lang/String;Ljava/lang/String;)V"), &arguments)?;
    let exception = env.cast_local::<JThrowable>(exception)?;
    match env.throw(exception) {
        Err(jni::errors::Error::JavaException) => Ok(()),
        other => other,
    }
}

/// The message of a panic: `panic!("text")` carries a `&str`, `panic!("{x}")` a `String`.
fn panic_text(payload: Box<dyn Any + Send>) -> String {
    match payload.downcast::<String>() {
        Ok(text) => *text,
        Err(payload) => payload.downcast_ref::<&'static str>().map_or("no message", |text| text).to_owned(),
    }
}
