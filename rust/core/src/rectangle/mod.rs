//! The rectangle of a face on its plane.

pub(crate) mod hypothesize;

use crate::{Calibration, Frame};
/// debug
pub fn debug_rect(frame: &Frame, calibration: &Calibration) -> Result<([[f64;2];4],[f32;4],[bool;4]),String> {
    use crate::image::redness::*;
    let (w,h,r)=half_redness(frame);
    let a=ridge_map(w,h,&r,Diagonal::Down); let b=ridge_map(w,h,&r,Diagonal::Up);
    let v=crate::stripe::grid_search::find_planes(calibration,&a,&b,5);
    let f=crate::face::extent::follow_stripes(frame,calibration,&v.first().ok_or("no plane")?.plane).ok_or("no stripes")?;
    let t=std::time::Instant::now();
    let r=hypothesize::hypothesize(frame,calibration,&f).map_err(|e|format!("{e:?}"));
    eprintln!("hyp {:?}",t.elapsed());
    let r=r?;
    let o=r.offsets_mm;
    let c=[(0,2),(1,2),(1,3),(0,3)].map(|(a,b)|{let p=r.raster.to_px(calibration,crate::face::raster::OnPlane::new(o[a],o[b])).unwrap();[p.u,p.v]});
    Ok((c,r.support,r.at_ends))
}
