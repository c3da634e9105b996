use omnidrones::controllers::*; use omnidrones::dynamics::*;
fn main() { for v in vehicles::all() { let plan = FlightPlan::default();
 let t = std::time::Instant::now(); let f = fly(&v, &v.gains(), &plan, |_| {}).unwrap(); let dt = t.elapsed().as_secs_f64();
 println!("{:12} T/W {:.2} rmse {:?} max {:?} sat {:?} div {:?} {:.2} s {:.2} us/step", v.name, v.thrust_to_weight(), f.log.rmse(2.0), f.log.max_error(2.0), f.log.saturation_share(), f.diverged_at, dt, dt/7500.*1e6); } }
