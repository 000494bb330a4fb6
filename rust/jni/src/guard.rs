//! The wall between Rust and the JVM: every native function runs inside [`guard`], and every failure leaves as a Java
//! exception of a type that says whose fault it was.

use boxline::ErrorKind;
use jni::errors::ErrorPolicy;
use jni::strings::{JNIStr, JNIString};
use jni::{Env, EnvUnowned, jni_str};
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
    /// A call into the JVM failed; mostly a Java exception is pending then.
    Jni(jni::errors::Error),
}

impl From<boxline::Error> for Failure {
    fn from(e: boxline::Error) -> Self {
        Self::Boxline(e)
    }
}

impl From<jni::errors::Error> for Failure {
    fn from(e: jni::errors::Error) -> Self {
        Self::Jni(e)
    }
}

const NATIVE_BUG: &JNIStr = jni_str!("dev/boxline/NativeBugException");

impl Failure {
    /// The exception's class and text.
    fn exception(&self) -> (&'static JNIStr, String) {
        match self {
            Self::Boxline(e) => (class_of(e.kind()), e.to_string()),
            Self::Handle(text) => (jni_str!("java/lang/IllegalStateException"), text.clone()),
            Self::Null(name) => (jni_str!("java/lang/NullPointerException"), format!("{name} is null")),
            Self::Argument(text) => (jni_str!("java/lang/IllegalArgumentException"), text.clone()),
            Self::Jni(e) => (NATIVE_BUG, format!("a call into the JVM failed: {e}")),
        }
    }
}

fn class_of(kind: ErrorKind) -> &'static JNIStr {
    match kind {
        ErrorKind::InvalidCalibration | ErrorKind::CalibrationMismatch => {
            jni_str!("dev/boxline/ScannerConfigException")
        }
        ErrorKind::InvalidFrame => jni_str!("dev/boxline/InvalidFrameException"),
        // No file is touched here, so any other kind is our mistake.
        _ => NATIVE_BUG,
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
            let (class, text) = failure.exception();
            throw(env, class, &text)?;
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

/// The message of a panic: `panic!("text")` carries a `&str`, `panic!("{x}")` a `String`.
fn panic_text(payload: Box<dyn Any + Send>) -> String {
    match payload.downcast::<String>() {
        Ok(text) => *text,
        Err(payload) => payload.downcast_ref::<&'static str>().map_or("no message", |text| text).to_owned(),
    }
}
