use super::conv::*; use super::product::*;
use std::time::Instant;
pub fn probe(s: ConvShape) {
    let n:usize=s.input.iter().product(); let m:usize=s.output().iter().product();
    let x:Vec<f32>=(0..n).map(|i|((i*7919)%13) as f32*0.1-0.6).collect();
    let w:Vec<f32>=(0..s.fan_in()*s.channels).map(|i|((i*104729)%17) as f32*0.01-0.08).collect();
    let mut p=Packed::default(); s.pack(&w,&mut p); let mut t=Packed::default(); s.pack_transposed(&w,&mut t);
    let mut y=vec![0.0;m]; let mut dw=vec![0.0;w.len()]; let mut dx=vec![0.0;n]; let mut sc=Scratch::default();
    let mut best=[f64::MAX;3];
    for _ in 0..12 {
        let a=Instant::now(); forward(&s,&x,&p,&mut y,Finish::default(),&mut sc); best[0]=best[0].min(a.elapsed().as_secs_f64());
        let a=Instant::now(); backward_weights(&s,&x,&y,&mut dw,&mut sc); best[1]=best[1].min(a.elapsed().as_secs_f64());
        let a=Instant::now(); backward_input(&s,&y,&t,&mut dx,&mut sc); best[2]=best[2].min(a.elapsed().as_secs_f64());
    }
    let f=2.0*s.products() as f64;
    println!("{:?} k{} s{} -> {:?}: {:.1} MFLOP fwd {:.2} ms {:.0} GF/s, dw {:.2} ms {:.0}, dx {:.2} ms {:.0}", s.input,s.kernel,s.stride,s.output(),f/1e6,best[0]*1e3,f/best[0]/1e9,best[1]*1e3,f/best[1]/1e9,best[2]*1e3,f/best[2]/1e9);
}
