//! Stripes: where the four lasers light a common plane ([`grid_search`]), sub-pixel centres along them ([`trace`],
//! [`peak`]).

pub(crate) mod grid_search;
pub mod peak;
pub(crate) mod trace;

use crate::{Calibration, Frame};
/// debug
pub fn debug_planes(frame: &Frame, calibration: &Calibration) -> Vec<([f64;3],[f32;4])> {
    use crate::image::redness::*;
    let t=std::time::Instant::now();
    let (w,h,r)=half_redness(frame);
    eprint!("red {:?} ",t.elapsed());
    let a=ridge_map(w,h,&r,Diagonal::Down); let b=ridge_map(w,h,&r,Diagonal::Up);
    eprint!("ridge {:?} ",t.elapsed());
    let v=grid_search::find_planes(calibration,&a,&b,5);
    eprintln!("search {:?} ",t.elapsed());
    v.into_iter().map(|g|([g.plane.per_mm.x,g.plane.per_mm.y,g.plane.per_mm.z],g.strength)).collect()
}
