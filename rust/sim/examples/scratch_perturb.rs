use boxline::Frame;
use boxline_proto::json::*;
use boxline_sim::perturb::*;
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let folder = std::path::Path::new(&args[1]);
    let recording = read_recording(folder).unwrap();
    let calibration = read_calibration(&recording.calibration_file).unwrap();
    let truth = read_truth(folder).unwrap().unwrap();
    for face in truth.faces.iter().filter(|f| f.frame == args[2]) {
        let file = &recording.frames.iter().find(|f| f.id == face.frame).unwrap().file;
        let frame = Frame::from_jpeg(&std::fs::read(file).unwrap()).unwrap();
        let shot = Shot::new(&frame, &calibration, face.corners_cam_mm);
        for (n, change) in Perturbation::all().iter().enumerate() {
            if !change.to_string().contains(&args[3]) {
                continue;
            }
            let start = std::time::Instant::now();
            let Some(after) = change.apply(&shot, 1).unwrap() else {
                println!("{change}: no room");
                continue;
            };
            println!("{n} {change} {:?}", start.elapsed());
            let mut bytes = Vec::new();
            let e = jpeg_encoder::Encoder::new(&mut bytes, 92);
            e.encode(
                after.rgb(),
                after.width_px() as u16,
                after.height_px() as u16,
                jpeg_encoder::ColorType::Rgb,
            )
            .unwrap();
            std::fs::write(format!("/tmp/perturb/{}_{n:02}.jpg", args[4]), bytes).unwrap();
        }
    }
}
