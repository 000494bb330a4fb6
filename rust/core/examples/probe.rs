use boxline::*;
fn main(){
    let cam=CameraModel{fx:2458.9172,fy:2453.81,skew:0.,cx:1239.5188,cy:1032.559,k1:-0.03415937,k2:0.321070446};
    let c=Calibration::new("x",[2592,1944],cam,[[0.0079291,-0.00817394,0.00018065,-1.0],[0.01078476,-0.01121147,0.00223845,-1.0],[0.01037354,0.00959161,0.00170705,-1.0],[0.00799885,0.00730513,-0.00038506,-1.0]]).unwrap();
    let st=Settings{method: if std::env::var("KP").is_ok(){Method::Keypoints}else{Method::Fit},..Default::default()};
    for f in std::env::args().skip(1){
        let fr=Frame::from_jpeg(&std::fs::read(&f).unwrap()).unwrap();
        let mut t=vec![];
        match measure_face(&fr,&c,&st,&mut t).unwrap(){
            FaceOutcome::Measured(m)=>println!("{f} rect {:?} {:?} {:?} rms {:.2} {:?}",m.corners_px.map(|p|[p.u,p.v]),m.length,m.width,m.rms_px,t.iter().map(|x|(x.0,x.1/100000)).collect::<Vec<_>>()),
            FaceOutcome::Rejected(r)=>println!("{f} reject {r:?} {:?}",t.iter().map(|x|(x.0,x.1/100000)).collect::<Vec<_>>())
        }
    }
}
