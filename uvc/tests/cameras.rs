//! Descriptors of real cameras and broken ones made from them, beside the tree: which mode is chosen, what is warned of, what is
//! refused. Where the folder is missing, the test says so.
#![allow(clippy::unwrap_used)] // the helpers of tests are tests

use boxline_uvc::descriptor::{Configuration, EndpointKind, VideoFunction, lint};
use boxline_uvc::emulator::descriptors;
use boxline_uvc::mode::{alternates_to_try, choose_mode};
use std::io::Write;
use std::path::{Path, PathBuf};

fn folder() -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/cases/descriptors");
    if folder.is_dir() {
        return Some(folder);
    }
    let mut stdout = std::io::stdout(); // what `println!` writes is hidden if the test passes
    writeln!(stdout, "SKIPPED cameras: {} is not there", folder.display()).unwrap();
    None
}

/// Mode and first alternate setting as a line, or why there is none.
fn chosen(configuration: &[u8]) -> String {
    let parsed = Configuration::parse(configuration).and_then(|parsed| VideoFunction::parse(&parsed));
    let mode = parsed.and_then(|video| {
        let mode = choose_mode(&video)?;
        Ok((video, mode))
    });
    match mode {
        Err(e) => format!("refused: {e}"),
        Ok((video, mode)) => {
            let stream = video.streaming.iter().find(|stream| stream.number == mode.interface).unwrap();
            let alternate = alternates_to_try(stream, u32::MAX)[0];
            let kind = if alternate.endpoint.kind == EndpointKind::Bulk { "bulk" } else { "isochronous" };
            format!(
                "{}x{} {} on interface {} setting {} {kind} {}",
                mode.width,
                mode.height,
                mode.interval,
                mode.interface,
                alternate.setting,
                alternate.endpoint.bytes_per_interval()
            )
        }
    }
}

/// One file: the mode and where the linter finds something.
struct Camera {
    name: &'static str,
    chosen: &'static str,
    findings: &'static [usize],
}

const REAL: [Camera; 18] = [
    Camera {
        name: "anker_powerconf_c200",
        chosen: "2560x1440 333333 on interface 1 setting 1 isochronous 2048",
        findings: &[69, 97],
    },
    Camera {
        name: "aveo_1871_0516",
        chosen: "refused: no video control interface (class 14, subclass 1)",
        findings: &[0],
    },
    Camera {
        name: "canyon_cne_cwc2",
        chosen: "1600x1200 666666 on interface 1 setting 6 isochronous 3072",
        findings: &[48],
    },
    Camera { name: "customer", chosen: "1280x720 666666 on interface 1 setting 0 bulk 64", findings: &[] },
    Camera {
        name: "customer_dual",
        chosen: "720x1280 666666 on interface 1 setting 1 isochronous 2048",
        findings: &[],
    },
    Camera { name: "dual_tusb", chosen: "480x270 500000 on interface 1 setting 0 bulk 512", findings: &[] },
    Camera {
        name: "elp_h264",
        chosen: "1920x1080 666666 on interface 1 setting 6 isochronous 3072",
        findings: &[],
    },
    Camera {
        name: "elp_h265",
        chosen: "2560x1440 666666 on interface 1 setting 4 isochronous 3072",
        findings: &[95, 121],
    },
    Camera { name: "isight_imac", chosen: "refused: no MJPEG frame size in the descriptors", findings: &[] },
    Camera {
        name: "logitech_c270",
        chosen: "1280x960 666666 on interface 1 setting 11 isochronous 3060",
        findings: &[],
    },
    Camera {
        name: "logitech_c920e",
        chosen: "1920x1080 666666 on interface 1 setting 11 isochronous 3072",
        findings: &[150],
    },
    Camera {
        name: "logitech_hd_pro_920",
        chosen: "1920x1080 666666 on interface 1 setting 11 isochronous 3060",
        findings: &[204],
    },
    Camera {
        name: "logitech_streamcam",
        chosen: "1920x1080 666666 on interface 1 setting 11 isochronous 3072",
        findings: &[122, 177, 205],
    },
    Camera {
        name: "ms_lifecam_show",
        chosen: "1600x1200 1333333 on interface 1 setting 7 isochronous 3072",
        findings: &[77],
    },
    Camera {
        name: "old",
        chosen: "640x480 666666 on interface 1 setting 5 isochronous 800",
        findings: &[122, 177, 205],
    },
    Camera {
        name: "quickcampro9000",
        chosen: "1600x1200 1000000 on interface 1 setting 11 isochronous 3060",
        findings: &[206],
    },
    Camera {
        name: "shine_3277_009e_uvc15",
        chosen: "1920x1080 333333 on interface 1 setting 7 isochronous 3060",
        findings: &[],
    },
    Camera {
        name: "trust_webcam",
        chosen: "refused: no MJPEG frame size in the descriptors",
        findings: &[48],
    },
];

const BROKEN: [Camera; 18] = [
    Camera {
        name: "audio_endpoint_of_5_bytes",
        chosen: "1280x720 666666 on interface 1 setting 0 bulk 64",
        findings: &[493, 4, 484],
    },
    Camera {
        name: "bulk_in_alternate_1",
        chosen: "1280x720 666666 on interface 1 setting 1 bulk 64",
        findings: &[],
    },
    Camera { name: "empty", chosen: "refused: descriptor at byte 0: no bytes", findings: &[0] },
    Camera {
        name: "extra_mjpeg_frame_short_20",
        chosen: "refused: descriptor at byte 130: 20 bytes, at least 26 are needed",
        findings: &[130],
    },
    Camera {
        name: "mjpeg_frame_claims_0_intervals_range",
        chosen: "refused: descriptor at byte 130: 34 bytes, at least 35 are needed",
        findings: &[130],
    },
    Camera {
        name: "mjpeg_frame_claims_9_intervals",
        chosen: "refused: descriptor at byte 130: 34 bytes, at least 35 are needed",
        findings: &[130],
    },
    Camera {
        name: "mjpeg_frame_range_5_to_30_fps",
        chosen: "1280x720 666666 on interface 1 setting 0 bulk 64",
        findings: &[],
    },
    Camera {
        name: "only_9",
        chosen: "refused: no video control interface (class 14, subclass 1)",
        findings: &[2, 4, 0],
    },
    Camera {
        name: "total_1_less",
        chosen: "1280x720 666666 on interface 1 setting 0 bulk 64",
        findings: &[477, 2],
    },
    Camera {
        name: "total_7_more_than_bytes_libusb767",
        chosen: "1280x720 666666 on interface 1 setting 0 bulk 64",
        findings: &[2],
    },
    Camera {
        name: "trailing_00_00",
        chosen: "1280x720 666666 on interface 1 setting 0 bulk 64",
        findings: &[484],
    },
    Camera {
        name: "trailing_short_endpoint_libusb522",
        chosen: "1280x720 666666 on interface 1 setting 0 bulk 64",
        findings: &[484],
    },
    Camera {
        name: "vc_header_count_2_of_1",
        chosen: "refused: descriptor at byte 26: 2 streaming interfaces in a header of 13 bytes",
        findings: &[26],
    },
    Camera {
        name: "vc_header_lists_interface_7",
        chosen: "refused: no MJPEG frame size in the descriptors",
        findings: &[0],
    },
    Camera {
        name: "vc_header_short_12",
        chosen: "refused: descriptor at byte 26: 1 streaming interfaces in a header of 12 bytes",
        findings: &[26, 26],
    },
    Camera {
        name: "xu_control_size_200",
        chosen: "refused: descriptor at byte 68: 200 bytes of controls in a unit of 27 bytes",
        findings: &[68],
    },
    Camera {
        name: "xu_pins_200",
        chosen: "refused: descriptor at byte 68: 200 inputs in a unit of 27 bytes",
        findings: &[68],
    },
    Camera {
        name: "zero_length_inside",
        chosen: "1280x720 666666 on interface 1 setting 0 bulk 64",
        findings: &[484],
    },
];

fn check(folder: &Path, cameras: &[Camera]) {
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .unwrap()
        .filter_map(|entry| entry.unwrap().file_name().to_str()?.strip_suffix(".config").map(str::to_owned))
        .collect();
    names.sort();
    assert_eq!(names, cameras.iter().map(|camera| camera.name).collect::<Vec<_>>());
    for camera in cameras {
        let file = folder.join(camera.name).with_extension("config");
        let bytes = std::fs::read(&file).unwrap();
        assert_eq!(chosen(&bytes), camera.chosen, "{}", camera.name);
        let device = std::fs::read(file.with_extension("device")).unwrap_or_else(|_| descriptors::device());
        let found = lint(&device, &bytes);
        let offsets: Vec<usize> = found.iter().map(|finding| finding.offset).collect();
        assert_eq!(offsets, camera.findings, "{}: {found:?}", camera.name);
    }
}

#[test]
fn real_cameras_have_a_mode_or_a_reason() {
    if let Some(folder) = folder() {
        check(&folder, &REAL);
    }
}

#[test]
fn broken_cameras_are_refused_only_where_their_video_is_at_fault() {
    if let Some(folder) = folder() {
        check(&folder.join("broken"), &BROKEN);
    }
}
