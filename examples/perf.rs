use omnidrones::autodiff::*;
use omnidrones::dynamics::*;
use omnidrones::parallel::Threads;
use std::time::Instant;
fn hb() -> Vehicle {
    let mut rotors = vec![];
    let mut parts = vec![Part::new("base", 0.68, [0.0; 3], Inertia::diagonal(0.007, 0.007, 0.012))];
    for (i, (x, y, s)) in [(0.17, 0., -1.), (0., 0.17, 1.), (-0.17, 0., -1.), (0., -0.17, 1.)].into_iter().enumerate() {
        rotors.push(Rotor {
            name: format!("r{i}"),
            position: [x, y, 0.01],
            axis: [0., 0., 1.],
            spin: s,
            thrust_coefficient: 8.54858e-6,
            moment_per_thrust: 0.016,
            max_speed: 838.0,
            time_constant_up: 0.0125,
            time_constant_down: 0.025,
            inertia: 7e-6,
            radius: 0.1,
            drag_coefficient: 8e-5,
            axial_drag_coefficient: 0.,
            rolling_coefficient: 0.,
        });
        parts.push(Part::new(format!("r{i}"), 0.009, [x, y, 0.01], Inertia::diagonal(4e-6, 4e-6, 7e-6)));
    }
    Vehicle {
        name: "hb".into(),
        source: "".into(),
        parts,
        rotors,
        drag: Drag { linear: [0.1; 3], ..Default::default() },
        published_gains: None,
    }
}
fn main() {
    let v = hb();
    for (name, effects) in [("lean", Effects::lean()), ("default", Effects::default())] {
        for integrator in [Integrator::RungeKutta4, Integrator::SemiImplicit] {
            let mut w = World::new(
                &v,
                Physics {
                    dt: 0.016,
                    substeps: if integrator == Integrator::RungeKutta4 { 1 } else { 2 },
                    integrator,
                    effects,
                },
                4096,
            )
            .unwrap();
            w.set_threads(Threads::new(1).unwrap());
            let a = vec![-0.41f32; 4096 * 4];
            let mut best = f64::MAX;
            for _ in 0..10 {
                let t = Instant::now();
                for _ in 0..50 {
                    w.step(&a).unwrap();
                }
                best = best.min(t.elapsed().as_secs_f64());
            }
            println!("world {name} {integrator:?}: {:.1} M steps/s", 50. * 4096. / best / 1e6);
        }
    }
    let sys = Multirotor::new(&v, Physics { dt: 0.016, effects: Effects::lean(), ..Default::default() }).unwrap();
    let x0 = sys.hover_state([0.; 3]).unwrap();
    let u = sys.hover_input().unwrap();
    let mut best = f64::MAX;
    let (mut x, mut y) = (x0.clone(), x0.clone());
    for _ in 0..10 {
        let t = Instant::now();
        for _ in 0..2000 {
            sys.step(&x, &u, &[], &mut y);
            std::mem::swap(&mut x, &mut y);
        }
        best = best.min(t.elapsed().as_secs_f64());
    }
    println!("f64 step {:.1} ns", best / 2000. * 1e9);
    let (mut xf, uf): (Vec<f32>, Vec<f32>) =
        (x0.iter().map(|v| *v as f32).collect(), u.iter().map(|v| *v as f32).collect());
    let mut yf = xf.clone();
    let mut best = f64::MAX;
    for _ in 0..10 {
        let t = Instant::now();
        for _ in 0..2000 {
            sys.step(&xf, &uf, &[], &mut yf);
            std::mem::swap(&mut xf, &mut yf);
        }
        best = best.min(t.elapsed().as_secs_f64());
    }
    println!("f32 step {:.1} ns", best / 2000. * 1e9);
    let rec = Recording::of(21, |z| {
        let mut n = vec![Trace::zero(); 17];
        sys.step(&z[..17], &z[17..], &[], &mut n);
        n
    });
    let f = Program::compile(&rec).unwrap();
    let adj = Program::compile(&rec.adjoint(0..21)).unwrap();
    println!("fwd {} ins {} slots; adj {} ins {} slots", f.len(), f.n_slot(), adj.len(), adj.n_slot());
    let mut z: Vec<f64> = x.clone();
    z.extend(&u);
    z[10] = 0.3;
    z[11] = -0.2;
    z[7] = 0.1;
    let mut ws = f.workspace();
    let mut o = vec![0.0; 17];
    let t = Instant::now();
    for _ in 0..2000 {
        f.evaluate(&mut ws, &z, &mut o);
    }
    println!("program f64 {:.0} ns", t.elapsed().as_secs_f64() / 2000. * 1e9);
    sys.step(&z[..17], &z[17..], &[], &mut y);
    println!("err {:e}", y.iter().zip(&o).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max));
    let mut zz = z.clone();
    zz.extend((0..17).map(|i| (i as f64).sin()));
    let mut ws = adj.workspace();
    let mut g = vec![0.0; 21];
    let t = Instant::now();
    for _ in 0..2000 {
        adj.evaluate(&mut ws, &zz, &mut g);
    }
    println!("adjoint f64 {:.0} ns", t.elapsed().as_secs_f64() / 2000. * 1e9);
    // dual check
    use num_dual::Dual64;
    let mut worst: f64 = 0.0;
    let t0 = Instant::now();
    for j in 0..21 {
        let zd: Vec<Dual64> =
            z.iter().enumerate().map(|(k, v)| Dual64::new(*v, if k == j { 1.0 } else { 0.0 })).collect();
        let mut n = vec![Dual64::new(0., 0.); 17];
        sys.step(&zd[..17], &zd[17..], &[], &mut n);
        let d: f64 = n.iter().enumerate().map(|(i, v)| v.eps * (i as f64).sin()).sum();
        worst = worst.max((d - g[j]).abs() / d.abs().max(1.0));
    }
    println!("adjoint vs dual {worst:e} ({:.1} us once)", t0.elapsed().as_secs_f64() * 1e6);
    let t0 = Instant::now();
    for _ in 0..1000 {
        for j in 0..21 {
            let zd: [Dual64; 21] = std::array::from_fn(|k| Dual64::new(z[k], if k == j { 1.0 } else { 0.0 }));
            let mut n = [Dual64::new(0., 0.); 17];
            sys.step(&zd[..17], &zd[17..], &[], &mut n);
            std::hint::black_box(n);
        }
    }
    println!("jacobian {:.2} us", t0.elapsed().as_secs_f64() * 1e3);
    let mut bw = adj.block_workspace();
    let bi: Vec<[f32; 64]> = zz.iter().map(|v| [*v as f32; 64]).collect();
    let mut bo = vec![[0f32; 64]; 21];
    let mut best = f64::MAX;
    for _ in 0..20 {
        let t = Instant::now();
        for _ in 0..200 {
            adj.evaluate_block(&mut bw, &bi, &mut bo);
        }
        best = best.min(t.elapsed().as_secs_f64());
    }
    println!(
        "adjoint lanes {:.0} ns per env = {:.2} M/s; err {:e}",
        best / 200. / 64. * 1e9,
        200. * 64. / best / 1e6,
        (0..21).map(|i| (bo[i][5] as f64 - g[i]).abs() / g[i].abs().max(1.0)).fold(0.0, f64::max)
    );
}
