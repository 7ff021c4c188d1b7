use super::*;

const CODES: Codes = Codes { potentiometer: [2_000, 2_100], bridge: [1_000, -3_000] };
const UP: BridgeInputs = [[1.0, 0.4], [1.0, 1.0]];

fn wired(fault: &str) -> Wiring {
    Wiring::new(vec![fault.parse().unwrap()], 1, 1_000.0, 0.005)
}

#[test]
fn names_are_read_back_and_wrong_ones_are_named() {
    for kind in Kind::ALL {
        for size in kind.sizes().iter().chain([&0.0; 1]) {
            let axis = usize::from(kind.has_axis());
            let size = if kind.sizes().is_empty() { 0.0 } else { *size };
            let fault = Fault { kind, axis, size };
            assert_eq!(fault.to_string().parse(), Ok(fault));
        }
    }
    assert!("leads".parse::<Fault>().unwrap_err().contains("leads-reversed"));
    for wrong in ["jammed:z", "motors-swapped:x", "jammed:x:3", "hum50:nan"] {
        assert!(wrong.parse::<Fault>().is_err(), "{wrong}");
    }
}

#[test]
fn motors_get_what_the_wires_give_them() {
    assert_eq!(motors_with("leads-reversed:x", UP), [[0.4, 1.0], [1.0, 1.0]]);
    assert_eq!(motors_with("motors-swapped", UP), [[1.0, 1.0], [1.0, 0.4]]);
    assert_eq!(motors_with("bridge-dead-up:x", UP), [[0.0, 0.0], [1.0, 1.0]]);
    assert_eq!(motors_with("bridge-dead-down:x", UP), UP);
    assert_eq!(motors_with("jammed:x", UP), [[0.0, 0.0], [1.0, 1.0]]);
    let mut wiring = wired("brown-out:2");
    let sags: Vec<bool> = (0..4)
        .map(|_| {
            wiring.motors(UP, 1e-3);
            wiring.sags()
        })
        .collect();
    assert_eq!(sags, [false, true, false, true], "each time that it is driven");
}

fn motors_with(fault: &str, inputs: [[f64; 2]; 2]) -> [[f64; 2]; 2] {
    wired(fault).motors(inputs, 1e-3)
}

#[test]
fn converters_read_what_the_wires_give_them() {
    assert_eq!(codes_with("potentiometer-reversed:y").potentiometer, [2_000, 1_995]);
    assert_eq!(codes_with("potentiometers-swapped").potentiometer, [2_100, 2_000]);
    assert_eq!(codes_with("potentiometer-open:x").potentiometer, [4_095, 2_100]);
    assert_eq!(codes_with("potentiometer-supply:0.5").potentiometer, [1_000, 1_050]);
    assert_eq!(codes_with("force-swapped").bridge, [-3_000, 1_000]);
    assert_eq!(codes_with("force-sign:y").bridge, [1_000, 3_000]);
    assert_eq!(codes_with("force-turned:90").bridge, [3_000, 1_000]);
    assert_eq!(codes_with("force-crosstalk:x:0.1").bridge, [700, -3_000]);
    assert_eq!(codes_with("force-gain:y:0.5").bridge, [1_000, -1_500]);
    assert_eq!(codes_with("force-saturated:y").bridge, [1_000, FORCE_CODE_MAX]);
    assert!(codes_with("force-dead:y").bridge[1].abs() < 10);
    let mut hum = wired("hum50:0.05");
    let mut most = 0;
    for _ in 0..40 {
        hum.motors(UP, 1e-3);
        most = most.max(hum.codes(CODES).bridge[0] - CODES.bridge[0]);
    }
    assert!((40..=60).contains(&most), "0.05 N are 50 codes: {most}");
    let mut repeats = wired("force-repeats");
    repeats.codes(CODES);
    assert_eq!(repeats.codes(Codes { bridge: [7, 7], ..CODES }).bridge, CODES.bridge);
}

fn codes_with(fault: &str) -> Codes {
    wired(fault).codes(CODES)
}

#[test]
fn the_emergency_stop_is_wired_in_four_ways() {
    assert_eq!(stop_lines("jammed"), [false, true]);
    assert_eq!(stop_lines("stop-not-wired"), [false, false]);
    assert_eq!(stop_lines("stop-normally-open"), [true, false]);
    assert_eq!(stop_lines("stop-open"), [true, true]);
}

fn stop_lines(fault: &str) -> [bool; 2] {
    [false, true].map(|pressed| wired(fault).stop_line(pressed))
}
