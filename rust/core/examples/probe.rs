use boxline::*;
fn main(){
    let cam=CameraModel{fx:2458.9172,fy:2453.81,skew:0.,cx:1239.5188,cy:1032.559,k1:-0.03415937,k2:0.321070446};
    let c=Calibration::new("x",[2592,1944],cam,[[0.0079291,-0.00817394,0.00018065,-1.0],[0.01078476,-0.01121147,0.00223845,-1.0],[0.01037354,0.00959161,0.00170705,-1.0],[0.00799885,0.00730513,-0.00038506,-1.0]]).unwrap();
    for f in std::env::args().skip(1){
        let t=std::time::Instant::now();
        let fr=Frame::from_jpeg(&std::fs::read(&f).unwrap()).unwrap();
        eprint!("{f} decode {:?} ",t.elapsed());
        match rectangle::debug_rect(&fr,&c){ Ok((p,s,e))=>println!("{f} rect {:?} {s:?} {e:?}",p), Err(e)=>println!("{f} reject {e}") }
    }
}
