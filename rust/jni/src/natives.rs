//! Every function that Java can call. Each does one thing: it calls `guard`.
//!
//! | Happens | Java sees |
//! |---|---|
//! | the calibration is broken, or the frames have another size | `dev.boxline.ScannerConfigException` |
//! | a frame is not a whole JPEG | `dev.boxline.InvalidFrameException` |
//! | a handle is closed or never was | `IllegalStateException` |
//! | an argument is null, a buffer is not direct | `NullPointerException`, `IllegalArgumentException` |
//! | a panic | `dev.boxline.NativeBugException`; the process lives |
//!
//! All functions may be called from any thread. A view that cannot be measured is a result, not an exception.
#![allow(unsafe_code)] // exporting a symbol counts as unsafe: two libraries could export the same one

use crate::buffer::{bytes_of_array, bytes_of_buffer};
use crate::guard::{Failure, guard};
use crate::handles::Handles;
use boxline::{Calibration, Frame, Settings, StageTimes};
use boxline_proto::json::parse_calibration;
use boxline_proto::message::encode_report;
use jni::objects::{JByteArray, JByteBuffer, JClass};
use jni::sys::jlong;
use jni::{EnvUnowned, jni_mangle};

static CALIBRATIONS: Handles<Calibration> = Handles::new();

/// `static native long openCalibration(byte[] json)`: reads a `calibration.json`. The handle is never 0 and must be
/// closed.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn open_calibration<'local>(
    env: EnvUnowned<'local>,
    _class: JClass<'local>,
    json: JByteArray<'local>,
) -> jlong {
    guard(env, |env| {
        let json = bytes_of_array(env, &json, "json")?;
        Ok(CALIBRATIONS.open(parse_calibration(&json, "calibration")?))
    })
}

/// `static native void closeCalibration(long handle)`: lets go of a calibration. Closing twice does nothing; calls that
/// are running finish.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn close_calibration<'local>(
    env: EnvUnowned<'local>,
    _class: JClass<'local>,
    handle: jlong,
) {
    guard(env, |_| CALIBRATIONS.close(handle).map_err(Failure::Handle));
}

/// `static native byte[] measureBox(long handle, ByteBuffer frameA, ByteBuffer frameB)`: measures a box from two frames.
/// Each buffer is direct and holds one JPEG from position to limit; both stay unchanged. Gives the bytes of a
/// `boxline.v1.BoxReport` whose faces are called `a` and `b`.
#[jni_mangle("dev.boxline.internal.Native")]
pub extern "system" fn measure_box<'local>(
    env: EnvUnowned<'local>,
    _class: JClass<'local>,
    handle: jlong,
    frame_a: JByteBuffer<'local>,
    frame_b: JByteBuffer<'local>,
) -> JByteArray<'local> {
    guard(env, |env| {
        let calibration = CALIBRATIONS.get(handle).map_err(Failure::Handle)?;
        let mut decode = |buffer, name| {
            let jpeg = bytes_of_buffer(env, buffer, name)?;
            Ok::<_, Failure>(Frame::from_jpeg(&jpeg).map_err(|e| e.in_context(name))?)
        };
        let (a, b) = (decode(&frame_a, "frameA")?, decode(&frame_b, "frameB")?);
        let report =
            boxline::measure_box(&a, &b, &calibration, &Settings::default(), &mut StageTimes::new())?;
        Ok(env.byte_array_from_slice(&encode_report(&report, ["a", "b"]))?)
    })
}

/// Entry points of `dev.boxline.internal.NativeTesting`, which prove the guard from the Java side.
#[cfg(feature = "testing")]
pub mod testing {
    use super::{CALIBRATIONS, Failure, guard};
    use crate::buffer::{bytes_of_array, bytes_of_buffer};
    use boxline::{Error, ErrorKind};
    use jni::objects::{JByteArray, JByteBuffer, JClass, JString};
    use jni::sys::jint;
    use jni::{EnvUnowned, jni_mangle};

    /// `static native byte[] echo(byte[] bytes)`.
    #[jni_mangle("dev.boxline.internal.NativeTesting")]
    pub extern "system" fn echo<'local>(
        env: EnvUnowned<'local>,
        _class: JClass<'local>,
        bytes: JByteArray<'local>,
    ) -> JByteArray<'local> {
        guard(env, |env| {
            let bytes = bytes_of_array(env, &bytes, "bytes")?;
            Ok(env.byte_array_from_slice(&bytes)?)
        })
    }

    /// `static native byte[] echoBuffer(ByteBuffer buffer)`: what a frame's bytes are seen to be.
    #[jni_mangle("dev.boxline.internal.NativeTesting")]
    pub extern "system" fn echo_buffer<'local>(
        env: EnvUnowned<'local>,
        _class: JClass<'local>,
        buffer: JByteBuffer<'local>,
    ) -> JByteArray<'local> {
        guard(env, |env| {
            let bytes = bytes_of_buffer(env, &buffer, "buffer")?;
            Ok(env.byte_array_from_slice(&bytes)?)
        })
    }

    /// `static native void panicWith(String message)`: panics with a `String`, with a `&str` if `message` is empty, with
    /// something else if it is null.
    #[jni_mangle("dev.boxline.internal.NativeTesting")]
    pub extern "system" fn panic_with<'local>(
        env: EnvUnowned<'local>,
        _class: JClass<'local>,
        message: JString<'local>,
    ) {
        guard(env, |env| {
            if message.is_null() {
                std::panic::panic_any(7);
            }
            let message = message.try_to_string(env)?;
            if message.is_empty() {
                panic!("a fixed text");
            }
            panic!("{message}")
        })
    }

    /// `static native long failWith(int kind, String text)`: fails with an error of the kind in the order of `ErrorKind`.
    #[jni_mangle("dev.boxline.internal.NativeTesting")]
    pub extern "system" fn fail_with<'local>(
        env: EnvUnowned<'local>,
        _class: JClass<'local>,
        kind: jint,
        text: JString<'local>,
    ) -> i64 {
        guard(env, |env| {
            let kind = match kind {
                0 => ErrorKind::InvalidCalibration,
                1 => ErrorKind::CalibrationMismatch,
                2 => ErrorKind::InvalidFrame,
                3 => ErrorKind::InvalidFile,
                4 => ErrorKind::Io,
                _ => return Err(Failure::Argument(format!("kind {kind} is not known"))),
            };
            Err(Error::new(kind, text.try_to_string(env)?).into())
        })
    }

    /// `static native int openCalibrations()`: how many calibrations are open.
    #[jni_mangle("dev.boxline.internal.NativeTesting")]
    pub extern "system" fn open_calibrations<'local>(
        env: EnvUnowned<'local>,
        _class: JClass<'local>,
    ) -> jint {
        guard(env, |_| jint::try_from(CALIBRATIONS.count()).map_err(|e| Failure::Argument(e.to_string())))
    }
}
