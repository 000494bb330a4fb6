//! A library that is none. In a program of its own: a process can try one library only.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

use boxline::ErrorKind;
use boxline_edgenet::{EdgeNet, Options, Runtime};
use std::path::PathBuf;

#[test]
fn a_library_that_is_none_is_an_error_now_and_later_and_the_engine_inside_goes_on() {
    let with = |runtime| EdgeNet::embedded(&Options { runtime, ..Options::default() });
    let none = PathBuf::from("/no/such/libonnxruntime.so");
    let missing = with(Runtime::OnnxRuntime(none)).unwrap_err();
    assert!(
        missing.kind() == ErrorKind::NetworkRuntime && missing.to_string().contains("no such library"),
        "{missing}"
    );
    let this_file = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/bad_library.rs");
    let text = with(Runtime::OnnxRuntime(this_file.clone())).unwrap_err();
    assert!(
        text.kind() == ErrorKind::NetworkRuntime && text.to_string().contains("bad_library.rs"),
        "{text}"
    );
    // Refused before ort is asked: it keeps a library that loaded and did not start.
    for again in [this_file, "/lib/x86_64-linux-gnu/libm.so.6".into()] {
        let error = with(Runtime::OnnxRuntime(again)).unwrap_err();
        assert!(error.to_string().contains("not tried"), "{error}");
    }
    assert_eq!(with(Runtime::Embedded).unwrap().runtime_name(), "embedded");
}
