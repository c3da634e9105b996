//! Filters against their closed forms, and against what other programs make of the same settings.

use super::*;

const PERIOD: f64 = 0.002;

#[test]
fn the_low_pass_halves_the_power_at_its_cut_off_and_rests_where_it_is_told() {
    let (filter, period) = (DigitalFilter::low_pass(12.0, 1.0 / 300.0), 1.0 / 300.0);
    let mut memory = filter.rest(2.5);
    let at_rest = filter.next(&mut memory, 2.5);
    println!("worst {:.1e}", (at_rest - 2.5_f64).abs());
    assert!((at_rest - 2.5).abs() < 1e-13);
    let (mut memory, mut power) = ([0.0; 2], 0.0);
    for step in 0..3000 {
        let y = filter.next(&mut memory, (2.0 * PI * 12.0 * f64::from(step) * period).sin());
        // sixty whole periods, long after the transient
        power += if step >= 1500 { 2.0 * y * y / 1500.0 } else { 0.0 };
    }
    println!("worst power {:.1e}", (power - 0.5).abs());
    // measured: 1.1e-15
    assert!((power - 0.5).abs() < 1e-10, "{power}");
}

/// ω of the continuous filter that a sampled one is at `frequency`, over that at `centre`.
fn warped(frequency: f64, centre: f64) -> f64 {
    (PI * frequency * PERIOD).tan() / (PI * centre * PERIOD).tan()
}

#[test]
fn responses_are_those_of_the_continuous_filters_at_warped_frequencies() {
    let (centre, bandwidth) = (80.0, 30.0);
    // s of the continuous notch whose sampled form is B wide
    let across = (PI * bandwidth * PERIOD).tan() * 2.0 / (2.0 * PI * centre * PERIOD).sin();
    let mut worst = 0.0_f64;
    for frequency in [0.01, 1.0, 20.0, 65.0, 80.0, 110.0, 200.0, 249.0] {
        let s = Complex::new(0.0, warped(frequency, centre));
        let rows = [
            (DigitalFilter::first_order_low_pass(centre, PERIOD), (s + 1.0).inv()),
            (DigitalFilter::low_pass(centre, PERIOD), (s * s + s * SQRT_2 + 1.0).inv()),
            (DigitalFilter::notch(centre, bandwidth, PERIOD), (s * s + 1.0) / (s * s + s * across + 1.0)),
        ];
        for (filter, closed) in rows {
            worst = worst.max((filter.response(2.0 * PI * frequency, PERIOD) - closed).norm());
        }
    }
    println!("worst {worst:.1e}");
    // measured: 3.5e-16
    assert!(worst < 1e-12);
}

#[test]
fn a_notch_takes_out_its_frequency_and_is_as_wide_as_it_is_told() {
    let (centre, bandwidth) = (150.0, 30.0);
    let filter = DigitalFilter::notch(centre, bandwidth, PERIOD);
    let gain = |frequency: f64| filter.response(2.0 * PI * frequency, PERIOD).norm();
    let half_power = |mut low: f64, mut high: f64| {
        let below = gain(low) < 0.5_f64.sqrt();
        for _ in 0..60 {
            let middle = f64::midpoint(low, high);
            if (gain(middle) < 0.5_f64.sqrt()) == below { low = middle } else { high = middle }
        }
        low
    };
    let width = half_power(centre, 249.0) - half_power(1.0, centre);
    println!(
        "{:.1e} left at its centre, {width:.12} Hz wide, {:.1e} off 1 at rest",
        gain(centre),
        (gain(0.0) - 1.0).abs()
    );
    // measured: 9.1e-17, 4e-13 Hz off, 0
    assert!(gain(centre) < 1e-12 && (width - bandwidth).abs() < 1e-8 && (gain(0.0) - 1.0).abs() < 1e-14);
}

/// `butter(1, 80, fs=500)`, `butter(2, 80, fs=500)` and `iirnotch(150, 5, fs=500)` of scipy.signal 1.17.1: b, then a behind its leading 1.
#[test]
fn coefficients_are_those_of_scipy() {
    let (first, second) = ([0.35473657163404176, 0.35473657163404176], [0.1453238838770424, 0.2906477677540848]);
    let (notch, turn) = ([0.8397996491122632, 0.6795992982245265], 0.519024726891614);
    let rows = [
        (DigitalFilter::first_order_low_pass(80.0, PERIOD), [first[0], first[1], 0.0], [-0.2905268567319164, 0.0]),
        (
            DigitalFilter::low_pass(80.0, PERIOD),
            [second[0], second[1], second[0]],
            [-0.6710290907740961, 0.2523246262822658],
        ),
        (DigitalFilter::notch(150.0, 30.0, PERIOD), [notch[0], turn, notch[0]], [turn, notch[1]]),
    ];
    let mut worst = 0.0_f64;
    for (own, b, a) in rows {
        let pairs = own.b.into_iter().chain(own.a).zip(b.into_iter().chain(a));
        worst = pairs.map(|(own, other)| (own - other).abs()).fold(worst, f64::max);
    }
    println!("worst {worst:.1e}");
    // measured: 1.1e-16
    assert!(worst < 1e-14);
}

/// The row runs as its responses say: a sinusoid behind two filters, each axis of another phase, held between two samples.
#[test]
fn a_row_of_filters_turns_and_shrinks_a_sinusoid_as_its_responses_say() {
    let all = FilterSettings::parse_list("low_pass:80,notch:150:30,low_pass:200:1").unwrap();
    let row = FilterRow::new(&all, PERIOD).unwrap();
    let omega = 2.0 * PI * 50.0;
    let expected: Complex<f64> = all.iter().map(|filter| filter.at(PERIOD).response(omega, PERIOD)).product();
    let (mut memory, mut worst) = (vec![0.0; row.n_memory()], 0.0_f64);
    let mut held = [0.0; 3];
    for step in 0..4000 {
        let (due, sample) = (step % 2 == 0, step / 2);
        let angle = |axis: usize| omega * f64::from(sample) * PERIOD + axis as f64;
        let y = row.filtered(f64::from(u8::from(due)), &mut memory, [0, 1, 2].map(|axis| angle(axis).sin()));
        if !due {
            assert_eq!(y, held);
        } else if sample > 1000 {
            for axis in 0..3 {
                worst = worst.max((y[axis] - expected.norm() * (angle(axis) + expected.arg()).sin()).abs());
            }
        }
        held = y;
    }
    println!("worst {worst:.1e}");
    // measured: 2.2e-13
    assert!(worst < 1e-11);
}

#[test]
fn a_row_begins_at_rest_where_it_first_measures() {
    let row = FilterRow::new(&FilterSettings::parse_list("notch:150:30,low_pass:20").unwrap(), PERIOD).unwrap();
    let mut memory = vec![0.0; row.n_memory()];
    for _ in 0..50 {
        let y = row.filtered(1.0, &mut memory, [1.0, -7.0, 0.0]);
        let worst = (y[0] - 1.0_f64).abs().max((y[1] + 7.0).abs()).max(y[2].abs());
        // measured: 4e-15
        assert!(worst < 1e-12, "{y:?}");
    }
}

#[test]
fn filters_that_cannot_be_are_refused_with_value_limit_and_remedy() {
    for (text, words) in [
        ("low_pas:80", "low_pass"),
        ("low_pass", "low_pass:FREQUENCY"),
        ("low_pass:80:3", "low_pass:FREQUENCY:ORDER"),
        ("low_pass:a", "'low_pass:a'"),
        ("notch:150", "notch:FREQUENCY:BANDWIDTH"),
        ("notch:150:30:2", "notch:FREQUENCY:BANDWIDTH"),
        ("", "kind of filter"),
    ] {
        let refusal = FilterSettings::parse_list(text).unwrap_err().to_string();
        assert!(refusal.contains(words), "{text}: {refusal}");
    }
    for (text, words) in [
        ("low_pass:80,low_pass:250", "filter 2 (low_pass): frequency is 250 Hz"),
        ("low_pass:0", "below 250 Hz"),
        ("low_pass:-3:1", "-3 Hz"),
        ("low_pass:nan", "NaN Hz"),
        ("notch:150:inf", "bandwidth"),
        ("notch:300:20", "300 Hz"),
        (
            "low_pass:9,low_pass:9,low_pass:9,low_pass:9,low_pass:9,low_pass:9,low_pass:9,low_pass:9,low_pass:9",
            "0 to 8",
        ),
    ] {
        let all = FilterSettings::parse_list(text).unwrap();
        let refusal = FilterRow::new(&all, PERIOD).unwrap_err().to_string();
        assert!(refusal.contains(words), "{text}: {refusal}");
    }
}

#[test]
fn settings_come_back_from_toml() {
    let text = "[[filter]]\nkind = \"low_pass\"\nfrequency = 80.0\n\n[[filter]]\nkind = \"notch\"\nfrequency = 150.0\nbandwidth = 30.0\n";
    let file: FilterFile = toml::from_str(text).unwrap();
    assert_eq!(file.filter, FilterSettings::parse_list("low_pass:80,notch:150:30").unwrap());
    assert_eq!(toml::from_str::<FilterFile>(&toml::to_string(&file).unwrap()).unwrap(), file);
    assert!(toml::from_str::<FilterFile>("[[filter]]\nkind = 'low_pass'\nfrequency = 80\nwidth = 2").is_err());
}
