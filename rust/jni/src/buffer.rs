//! Bytes from Java.

use crate::guard::Failure;
use jni::objects::{JByteArray, JByteBuffer};
use jni::sys::jint;
use jni::{Env, jni_sig, jni_str};

/// A copy of the bytes between position and limit of a direct buffer; the buffer itself is not changed.
///
/// A copy, because Java may write to the buffer at any time, and no Rust slice may see that. It costs less than 1 ms a
/// frame.
pub(crate) fn bytes_of_buffer(
    env: &mut Env<'_>,
    buffer: &JByteBuffer<'_>,
    name: &'static str,
) -> Result<Vec<u8>, Failure> {
    if buffer.is_null() {
        return Err(Failure::Null(name));
    }
    let capacity = env
        .get_direct_buffer_capacity(buffer)
        .map_err(|e| Failure::Argument(format!("{name} is not a direct buffer ({e})")))?;
    let mut index = |method| {
        let index: jint = env.call_method(buffer, method, jni_sig!("()I"), &[])?.i()?;
        usize::try_from(index).map_err(|e| Failure::Argument(format!("{name}: index {index}: {e}")))
    };
    let (position, limit) = (index(jni_str!("position"))?, index(jni_str!("limit"))?);
    // Another thread may move them between the two calls; the capacity cannot change.
    if position > limit || limit > capacity {
        return Err(Failure::Argument(format!(
            "{name}: position {position}, limit {limit}, capacity {capacity}"
        )));
    }
    let len = limit - position;
    let mut bytes = vec![0; len];
    if len > 0 {
        let start = env.get_direct_buffer_address(buffer)?;
        // SAFETY: `start` is not null (checked by the call above) and begins `capacity` bytes that stay where they are
        // while `buffer`, a reference of the running call, keeps the object alive. position + len = limit <= capacity.
        // `bytes` is new memory of `len` bytes, so the two do not overlap.
        #[allow(unsafe_code)]
        unsafe {
            std::ptr::copy_nonoverlapping(start.add(position), bytes.as_mut_ptr(), len);
        }
    }
    Ok(bytes)
}

/// A copy of a Java byte array.
pub(crate) fn bytes_of_array(
    env: &Env<'_>,
    array: &JByteArray<'_>,
    name: &'static str,
) -> Result<Vec<u8>, Failure> {
    if array.is_null() {
        return Err(Failure::Null(name));
    }
    Ok(env.convert_byte_array(array)?)
}
