#[path = "../primitives/table.rs"]
mod table;
use protocol::*;
use scene::*;
use sim::*;
use std::collections::BTreeMap;

#[test]
fn explore(){
    let sources = tests::files::sources();
    let which = std::env::var("PACK").unwrap();
    let pack = AssetPack::open(&which,&sources).unwrap();
    let mut s = Simulator::new(SimulatorConfig{pack, sources: sources.clone(), gl_device: GlDevice::Auto, cached_scenes:1});
    let every: u16 = std::env::var("EVERY").ok().map_or(1,|e|e.parse().unwrap());
    for task in TaskRef::all() {
        if let Ok(f)=std::env::var("SUITE") { if task.suite().name()!=f {continue;} }
        let problem = TaskFiles::of_task(&sources, task).problem().unwrap();
        let mut load=(0.0,String::new()); let mut during=load.clone(); let mut end=load.clone(); let mut last3=load.clone();
        let mut drift=(0.0,String::new()); let mut low=(1.0f64,String::new()); let mut untrue: BTreeMap<String,usize>=BTreeMap::new(); let mut over5=0; let mut succ=0;
        let ws = scene::arena::arena(&problem.name).unwrap().workspace_offset[2].max(0.0);
        for st in (0..50u16).step_by(every as usize) {
            let id: RolloutId = format!("{}/t{}/clean/L0/c{st:02}",task.suite().short_name(),task.index()).parse().unwrap();
            let row=ManifestRow::new(id,st,st,Perturbation::default());
            let mut ep=s.begin(&row,Realisation::Matched).unwrap();
            let rel=table::entities(&mut ep);
            let mut see=|w:&mut (f64,String), d:(f64,String)| if d.0>w.0 {*w=(d.0,format!("s{st} {}",d.1))};
            see(&mut load, table::deepest_overlap(ep.environment()));
            for i in 0..10 { ep.environment().step(&sim::episode::NO_OP).unwrap(); let d=table::deepest_overlap(ep.environment()); see(&mut during,d.clone()); if i>=7 {see(&mut last3,d.clone());} if i==9 { if d.0>0.005{over5+=1}; see(&mut end,d);} }
            if ep.environment().succeeded(){succ+=1}
            let now=table::entities(&mut ep);
            for b in rel.iter().filter(|e|e.kind==EntityKind::Object){
                let a=now.iter().find(|e|e.name==b.name).unwrap();
                see(&mut drift,((a.pos[0]-b.pos[0]).hypot(a.pos[1]-b.pos[1]),b.name.clone()));
                let bottom=a.centre[2]-a.half_extents[2]-ws;
                if bottom<low.0 {low=(bottom,format!("s{st} {}",b.name));}
            }
            for p in table::untrue(&problem.init, ep.environment()) { *untrue.entry(p.to_string()).or_default()+=1; }
        }
        println!("{task} load {:.2}mm [{}] during {:.2} [{}] last3 {:.2} end {:.2} [{}] over5 {over5} | drift {:.0}mm [{}] | low {:.1}mm [{}] | succ {succ} | untrue {untrue:?}", load.0*1e3,load.1,during.0*1e3,during.1,last3.0*1e3,end.0*1e3,end.1,drift.0*1e3,drift.1,low.0*1e3,low.1);
    }
}
