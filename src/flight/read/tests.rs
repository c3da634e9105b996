use super::*;

#[test]
fn a_header_of_endless_columns_is_refused_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.csv");
    for (n, last) in [(1, "rotor_speed_7"), (50_000, "x"), (50_000, "time")] {
        let rotors: Vec<String> = (0..n).map(|k| format!("rotor_speed_{k}")).collect();
        std::fs::write(&path, format!("{},{last}\n1,2\n", rotors.join(","))).unwrap();
        let begun = std::time::Instant::now();
        let text = FlightLog::read_csv(&path).unwrap_err().to_string();
        assert!(text.contains("line 1: has no column '"), "{text}");
        assert!(begun.elapsed().as_secs() < 20, "{n}: {:?}", begun.elapsed());
    }
    // of all the columns of a flight but the last, every one is looked for
    let n = 50_000;
    let mut names = FlightLog::new("", &vec![1.0; n]).csv_header();
    names.pop();
    names.reverse();
    std::fs::write(&path, names.join(",") + "\n").unwrap();
    let begun = std::time::Instant::now();
    assert!(FlightLog::read_csv(&path).unwrap_err().to_string().contains("has no column"));
    assert!(begun.elapsed().as_secs() < 20, "{:?}", begun.elapsed());
}
