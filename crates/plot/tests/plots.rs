//! Figures are written whole, at their size, from any data.

use omnidrones::flight::{FlightLog, FlightSample};
use omnidrones_plot::flight::FlightFigures;
use omnidrones_plot::{Bar, Bars, Colour, Figure, HeatMap, Panel, Path3d, Pose, Series};

fn push(log: &mut FlightLog, time: f64, position: [f64; 3], reference: [f64; 3]) {
    let rotors = vec![400.0 + 50.0 * time.sin(); log.n_rotor()];
    let sample = FlightSample {
        time,
        position,
        velocity: [time.cos(), 0.5, 0.0],
        attitude: [1.0, 0.05 * time.sin(), 0.0, 0.0],
        angular_velocity: [0.0; 3],
        reference_position: reference,
        reference_velocity: [time.cos(), 0.5, 0.0],
        reference_acceleration: [-time.sin(), 0.0, 0.0],
        reference_yaw: 0.0,
        rotor_speed: &rotors,
        rotor_command: &rotors,
        thrust: &rotors,
        wind: [0.0; 3],
    };
    log.push(sample).unwrap();
}

/// A lemniscate with a little deterministic noise.
fn lemniscate() -> FlightLog {
    let mut log = FlightLog::new("test", &[800.0; 4]);
    for i in 0..1500 {
        let t = 0.01 * f64::from(i);
        let reference = [2.5 * t.sin(), 2.5 * t.sin() * t.cos(), 1.5];
        push(&mut log, t, reference.map(|r| r + 0.02 * (31.0 * t + r).sin()), reference);
    }
    log
}

fn png_size(bytes: &[u8]) -> (u32, u32) {
    assert_eq!(&bytes[..8], b"\x89PNG\r\n\x1a\n");
    let word = |at: usize| u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap());
    (word(16), word(20))
}

#[test]
fn a_flight_gives_six_png_figures_of_two_pixels_per_unit() {
    let folder = tempfile::tempdir().unwrap();
    let written = FlightFigures::new(&lemniscate(), 2.0).save(folder.path(), "png").unwrap();
    let sizes: Vec<_> = written.iter().map(|p| png_size(&std::fs::read(p).unwrap())).collect();
    assert_eq!(sizes, [(2000, 1400), (1600, 1120), (1600, 1000), (1600, 1000), (1600, 1120), (1600, 1120)]);
    let files = std::fs::read_dir(folder.path()).unwrap().count();
    assert_eq!(files, 6, "temporary files were left behind");
}

#[test]
fn an_svg_figure_holds_its_text_as_text_with_a_fallback_font() {
    let folder = tempfile::tempdir().unwrap();
    for path in FlightFigures::new(&lemniscate(), 2.0).save(folder.path(), "svg").unwrap() {
        let text = std::fs::read_to_string(path).unwrap();
        assert!(text.starts_with("<svg width=\"") && text.trim_end().ends_with("</svg>"));
        assert!(text.contains("tracking RMSE") && text.contains("sans-serif"));
        assert!(!text.contains("NaN"));
    }
}

#[test]
fn an_unknown_extension_is_refused_with_the_two_that_work() {
    let error = Figure::new("").save("figure.pdf").unwrap_err().to_string();
    assert!(error.contains("'pdf'") && error.contains("png or svg"), "{error}");
}

#[test]
fn a_chart_outside_the_grid_and_an_absurd_size_are_errors() {
    let panel = Panel::new("", "", "");
    assert!(Figure::new("").grid(&[1.0], &[1.0]).place((1, 0), (1, 1), panel.clone()).svg().is_err());
    assert!(Figure::new("").grid(&[0.0], &[1.0]).svg().is_err());
    for size in [0.0, f64::NAN, 1e12] {
        assert!(Figure::new("").size(size, 300.0).chart(panel.clone()).svg().is_err());
    }
}

#[test]
fn degenerate_curves_still_give_a_figure() {
    let folder = tempfile::tempdir().unwrap();
    let broken = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX, f64::MIN, 5e-324, 0.0, -0.0, 1e300, -1e149];
    let mut cases: Vec<Vec<(f64, f64)>> = vec![vec![], vec![(1.0, 2.0)], vec![(0.0, 3.0); 2000]];
    cases.extend(broken.map(|v| vec![(v, v)]));
    cases.extend(broken.map(|v| vec![(0.0, 1.0), (1.0, v), (2.0, 1.0), (v, 1.0)]));
    cases.push((0..5000).map(|i| (f64::from(i), if i % 2 == 0 { 1e149 } else { -1e149 })).collect());
    cases.push((0..5000).map(|i| (f64::from(i), 1e9 + 1e-5 * f64::from(i))).collect());
    for points in cases {
        for (log, dashed) in [(false, false), (true, true), (false, true)] {
            let series = Series { dashed, markers: dashed, ..Series::line("s", points.clone()) };
            let mut panel = Panel::new("t", "x", "y").series(series).level("l", 1.0, Colour::GREY);
            (panel.log_x, panel.log_y) = (log, log);
            let figure = Figure::new("f").size(300.0, 200.0).chart(panel);
            figure.save(folder.path().join("figure.png")).unwrap();
            let svg = figure.svg().unwrap();
            assert!(!svg.contains("NaN") && !svg.contains("inf\""), "{points:?}");
        }
    }
}

#[test]
fn degenerate_paths_and_bars_still_give_a_figure() {
    let folder = tempfile::tempdir().unwrap();
    let paths: [Vec<[f64; 3]>; 6] = [
        vec![],
        vec![[1.0, 2.0, 3.0]],
        vec![[1.0; 3]; 50],
        vec![[f64::NAN; 3]; 5],
        vec![[0.0; 3], [f64::INFINITY; 3], [1e140, 0.0, -1e140], [1e-300; 3]],
        (0..50).map(|i| [f64::from(i), 0.0, 0.0]).collect(),
    ];
    for path in paths {
        let pose = Pose { position: [f64::NAN, 0.0, 0.0], attitude: [0.0; 4] };
        let chart =
            Path3d::new("p", path.clone()).reference(path.clone()).heat("h", vec![1.0, f64::NAN]).poses(vec![pose]);
        let figure = Figure::new("f").size(300.0, 300.0).chart(chart);
        figure.save(folder.path().join("path.png")).unwrap();
        figure.svg().unwrap();
    }
    for values in [vec![], vec![0.0], vec![f64::NAN, -1.0], vec![1e-300, 1e300]] {
        let mut bars = Bars::new("b", "x").baseline("one", 1.0);
        bars.bars = values.into_iter().map(|v| Bar::new("bar", v)).collect();
        let figure = Figure::new("f").size(300.0, 300.0).chart(bars.clone()).chart(bars.log());
        figure.save(folder.path().join("bars.png")).unwrap();
        figure.svg().unwrap();
    }
}

#[test]
fn empty_short_and_diverged_flights_give_all_figures() {
    let mut logs = vec![FlightLog::default(), FlightLog::new("no samples", &[800.0; 6])];
    let mut one = FlightLog::new("one sample", &[800.0; 4]);
    push(&mut one, 0.0, [0.0; 3], [1.0; 3]);
    let mut diverged = lemniscate();
    for i in 700..1500 {
        diverged.position[i] = [f64::NAN; 3];
        diverged.attitude[i] = [f64::NAN; 4];
        diverged.rotor_speed[4 * i] = f64::INFINITY;
    }
    let mut exploded = lemniscate();
    exploded.position[900] = [1e308; 3];
    exploded.time[901] = f64::NAN;
    logs.extend([one, diverged, exploded]);
    for log in logs {
        for (name, figure) in FlightFigures::new(&log, 2.0).named() {
            assert!(figure.svg().unwrap().len() > 500, "{}: {name}", log.vehicle);
        }
    }
}

#[test]
fn an_event_is_named_once_per_chart_with_room_and_drawn_in_all_over_time() {
    let plain = FlightFigures::new(&lemniscate(), 2.0);
    let marked = plain.clone().event("failure", 3.0);
    let names = |figures: &FlightFigures| -> Vec<usize> {
        figures
            .named()
            .iter()
            .map(|(_, f)| f.svg().unwrap().lines().filter(|l| l.trim() == "failure").count())
            .collect()
    };
    assert_eq!(names(&plain), [0; 6]);
    // overview, path, error, rotors, attitude, rates: charts with a shaded start have the line without its name
    assert_eq!(names(&marked), [3, 0, 0, 2, 3, 3]);
    assert_ne!(plain.error.svg().unwrap(), marked.error.svg().unwrap());
    assert_eq!(plain.path, marked.path);
}

#[test]
fn a_ribbon_fills_the_room_between_two_curves_and_leaves_gaps() {
    let edge = |i: i32| (f64::from(i), 1.0, if i == 5 { f64::NAN } else { 2.0 + f64::from(i) });
    let panel =
        Panel::new("Spread", "time [s]", "error [m]").ribbon("10 to 90 %", (0..12).map(edge).collect(), Colour::BLUE);
    let svg = Figure::new("A ribbon").chart(panel).svg().unwrap();
    let plain = Figure::new("A ribbon").chart(Panel::new("Spread", "time [s]", "error [m]")).svg().unwrap();
    let polygons = |text: &str| text.matches("<polygon").count();
    assert_eq!(polygons(&svg), polygons(&plain) + 2, "one before the gap, one behind it");
    assert!(
        svg.contains("10 to 90 %") && svg.lines().any(|line| line == "12"),
        "the axis reaches the upper edge: {svg}"
    );
}

#[test]
fn a_negative_bar_goes_to_the_left_of_zero() {
    let edges = |value: f64| {
        let svg = Figure::new("").chart(Bars::new("b", "x").bar(Bar::new("bar", value))).svg().unwrap();
        svg.matches("<rect").count()
    };
    assert_eq!(edges(-2.0), edges(2.0), "it is drawn");
}

#[test]
fn a_step_is_not_cut_off_and_a_far_start_is() {
    let mut step = FlightLog::new("step", &[800.0; 4]);
    for i in 0..1000 {
        let t = 0.01 * f64::from(i);
        let reference = if t < 1.0 { [0.0, 0.0, 2.0] } else { [2.0, 0.0, 2.0] };
        let lag = if t < 1.0 { 0.0 } else { 2.0 * (-3.0 * (t - 1.0)).exp() };
        push(&mut step, t, [reference[0] - lag, 0.0, 2.0], reference);
    }
    assert!(!FlightFigures::new(&step, 2.0).error.svg().unwrap().contains("start cut off"));
    let mut far = FlightLog::new("far", &[800.0; 4]);
    for i in 0..1000 {
        let t = 0.01 * f64::from(i);
        push(&mut far, t, [2.0 * (-3.0 * t).exp() + 0.001 * t.sin(), 0.0, 2.0], [0.0, 0.0, 2.0]);
    }
    assert!(FlightFigures::new(&far, 2.0).error.svg().unwrap().contains("start cut off"));
}

#[test]
fn sixteen_rotors_are_panels_of_four_and_wind_has_one_of_its_own() {
    let mut log = FlightLog::new("many", &[800.0; 16]);
    for i in 0..100 {
        push(&mut log, 0.01 * f64::from(i), [0.0; 3], [0.0; 3]);
    }
    let calm = FlightFigures::new(&log, 0.0);
    let rotors = calm.rotors.svg().unwrap();
    assert_eq!(rotors.matches("Speed of rotors").count(), 4, "{rotors}");
    assert!(calm.overview.svg().unwrap().contains("Speeds of 16 rotors"));
    assert!(!calm.overview.svg().unwrap().contains("Wind"));
    log.wind = vec![[3.0, 0.0, 0.0]; log.len()];
    assert!(FlightFigures::new(&log, 0.0).overview.svg().unwrap().contains("Wind"));
}

#[test]
fn a_heat_map_writes_its_shares_and_leaves_gaps_pale() {
    let map = HeatMap::new("Shares", "tilt [°]", "rate [rad/s]")
        .ranges((0.0, 180.0), (0.0, 12.0))
        .row(vec![1.0, 0.5, f64::NAN], vec!["100".into(), "50".into(), String::new()])
        .row(vec![0.0], vec!["0".into()]);
    let svg = Figure::new("Map").chart(map).svg().unwrap();
    assert!(svg.contains("Shares") && svg.contains("180") && svg.contains("tilt"));
    assert!(Figure::new("").chart(HeatMap::default()).svg().is_ok());
}
