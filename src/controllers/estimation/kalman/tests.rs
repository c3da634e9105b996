//! The linear filters against scipy 1.17.1 and python-control 0.10.2, on a cart with a load that hangs from it.

use super::*;
use crate::design::lqr;
use crate::linear::margins;
use nalgebra::{dmatrix, dvector};

const DT: f64 = 0.02;

fn system(dt: Option<f64>) -> StateSpace {
    let a = match dt {
        Some(_) => dmatrix![
            1.0, DT, 0.0004, 0.0;
            0.0, 1.0, 0.03, 0.0003;
            0.0, 0.0, 0.998, DT;
            0.0, 0.0, -0.19, 0.997
        ],
        // ln A/Δt of the one above
        None => dmatrix![
            0.0, 1.0, 0.004984147591602467, -0.00015000734436415532;
            0.0, 0.0, 1.501023395179607, -1.801233265569469e-05;
            0.0, 0.0, -0.0048370083654158125, 1.0012330512956393;
            0.0, 0.0, -9.511713987308562, -0.05489866093019277
        ],
    };
    let b = dmatrix![0.0002; 0.02; -0.0001; -0.012];
    let c = dmatrix![1.0, 0.0, 0.0, 0.0; 0.2, 0.0, 1.0, 0.0];
    StateSpace::new(a, b, c, DMatrix::zeros(2, 1), dt).unwrap()
}

fn noise() -> [DMatrix<f64>; 2] {
    let mut process = DMatrix::from_diagonal(&dvector![1e-6, 4e-4, 1e-7, 9e-4]);
    (process[(1, 3)], process[(3, 1)]) = (2e-4, 2e-4);
    [process, dmatrix![2e-4, 1e-5; 1e-5, 3e-4]]
}

/// Largest difference as a share of the largest number.
fn off(a: &DMatrix<f64>, b: &DMatrix<f64>) -> f64 {
    (a - b).amax() / b.amax()
}

#[test]
fn steady_gains_are_those_of_scipy() {
    let [process, noise] = noise();
    let found = steady_kalman(&system(Some(DT)), &process, &noise).unwrap();
    let sampled = dmatrix![
        0.21397577448433766, 0.019665018472069952;
        1.1914693001894274, 0.26502829420377494;
        -0.013725164756231013, 0.21859352213929184;
        0.08933054191976277, 1.3498097163685108
    ];
    let continuous = dmatrix![
        12.0500011632817, 1.2540010611002463;
        67.4936313935717, 15.875946688014848;
        -0.5560136867200808, 12.339501865343852;
        6.4561433991661845, 76.71276514159328
    ];
    let flowing = steady_kalman(&system(None), &(&process / DT), &(&noise * DT)).unwrap();
    println!("L off by {:.1e}, continuous {:.1e}", off(&found.gain, &sampled), off(&flowing.gain, &continuous));
    assert!(off(&found.gain, &sampled) < 1e-10 && off(&flowing.gain, &continuous) < 1e-10);
    assert!(found.poles[0].norm() < 1.0 && flowing.poles.iter().all(|pole| pole.re < 0.0));
}

#[test]
fn a_filter_that_goes_on_comes_to_the_steady_one() {
    let ([process, noise], system) = (noise(), system(Some(DT)));
    let steady = steady_kalman(&system, &process, &noise).unwrap();
    let mut filter = KalmanFilter::new(DVector::zeros(4), DMatrix::identity(4, 4)).unwrap();
    for _ in 0..2000 {
        filter.predict([system.a(), system.b()], &dvector![0.0], &process);
        let nothing_new = system.c() * &filter.state;
        filter.correct([system.c(), system.d()], &dvector![0.0], &nothing_new, &noise).unwrap();
    }
    assert!(off(&filter.covariance, &steady.corrected) < 1e-10, "{:e}", off(&filter.covariance, &steady.corrected));
}

#[test]
fn a_linear_case_is_that_of_numpy() {
    let ([process, noise], system) = (noise(), system(Some(DT)));
    let start = DMatrix::from_diagonal(&dvector![0.1, 0.2, 0.05, 0.3]);
    let mut filter = KalmanFilter::new(DVector::zeros(4), start).unwrap();
    let mut last = f64::NAN;
    for k in 0..6 {
        let k = f64::from(k);
        let u = dvector![(k + 1.0).sin()];
        filter.predict([system.a(), system.b()], &u, &process);
        let y = dvector![0.1 * k.cos(), 0.2 * (0.5 * k).sin()];
        last = filter.correct([system.c(), system.d()], &u, &y, &noise).unwrap().squared;
    }
    let state = dvector![-0.05101316235763803, -0.9519549200817605, 0.19154683899067126, 1.211757699345756];
    let covariance = dmatrix![
        9.626037452548101e-05, 0.0012554277215285135, -1.2976220124298974e-05, -0.00015505210668814864;
        0.0012554277215285111, 0.026321950332823724, -0.00015193980693258214, -0.0027038467911992595;
        -1.2976220124299965e-05, -0.00015193980693259623, 0.00014482478214249717, 0.0018671069856621685;
        -0.00015505210668816279, -0.002703846791199312, 0.0018671069856621698, 0.03924356080863709
    ];
    assert!((&filter.state - state).amax() < 1e-12 && off(&filter.covariance, &covariance) < 1e-11);
    assert!((last - 87.34214557486182).abs() < 1e-9 * last, "{last}");
}

#[test]
fn margins_of_lqg_are_those_of_its_response_in_python_control() {
    let ([process, noise], system) = (noise(), system(Some(DT)));
    let filter = steady_kalman(&system, &process, &noise).unwrap();
    let weights = DMatrix::from_diagonal(&dvector![10.0, 1.0, 5.0, 0.1]);
    let regulator = lqr(system.a(), system.b(), &weights, &dmatrix![0.5]).unwrap();
    let gain = dmatrix![4.312114343693051, 3.528174789967272, -1.7464619589224832, -0.06912029283969115];
    assert!(off(&regulator.gain, &gain) < 1e-10);
    let compensator = lqg(&system, &filter, &regulator.gain).unwrap();
    // cut at the command, closed with −1
    let cut = system.series(&compensator.scaled(-1.0)).unwrap();
    let found = margins(&cut).unwrap();
    println!("{:?} {:?}", found.gains, found.phases);
    assert!(found.stable);
    // roots of the loop's response there, by Brent's method
    for (omega, degrees) in [(2.1426286514362674, 48.07789016715881), (3.6119027260976613, 45.240245842164114)] {
        let own = found.phases.iter().find(|own| (own.omega - omega).abs() < 1e-6).expect("a crossover");
        assert!((own.margin.to_degrees().abs() - degrees).abs() < 1e-6, "{own:?}");
    }
    let own = found.gains.iter().find(|own| (own.omega - 9.590196412928432).abs() < 1e-6).expect("a crossing");
    assert!((own.margin - 1.0 / 0.2039033947286339).abs() < 1e-8, "{own:?}");
}

#[test]
fn what_no_filter_can_know_is_refused_by_name() {
    let ([process, noise], system) = (noise(), system(Some(DT)));
    let blind = StateSpace::new(
        system.a().clone(),
        system.b().clone(),
        dmatrix![0.0, 1.0, 0.0, 0.0],
        DMatrix::zeros(1, 1),
        Some(DT),
    )
    .unwrap();
    let told = steady_kalman(&blind, &process, &dmatrix![1e-4]).unwrap_err().to_string();
    assert!(told.contains("x0") && told.contains("seen by an output"), "{told}");
    for (process, noise, words) in [
        (DMatrix::identity(3, 3), noise.clone(), "covariance W is 3 × 3"),
        (process.clone(), dmatrix![1.0, 2.0; 0.0, 1.0], "asymmetric"),
        (process.clone() * f64::NAN, noise.clone(), "NaN"),
        (-process.clone(), noise.clone(), "≥ 0"),
    ] {
        let told = steady_kalman(&system, &process, &noise).unwrap_err().to_string();
        assert!(told.contains(words), "{told}");
    }
    let mut filter = KalmanFilter::new(DVector::zeros(4), DMatrix::identity(4, 4)).unwrap();
    let before = filter.clone();
    let told = filter.correct([system.c(), system.d()], &dvector![0.0], &dvector![f64::NAN, 0.0], &noise);
    assert!(told.is_err() && filter == before);
}
