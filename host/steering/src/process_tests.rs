use super::*;
use crate::{Options, ReplayPlant, SteerError, steer};
use std::sync::{Arc, Mutex};

const STATEMENT: &str = r#"{"plant":"needle/1","needle":{"EI_n_m2":0.0157,"outer_diameter_mm":1.27},"rig":{"guide1_to_guide2_mm":60,"guide2_to_surface_mm":20,"move_while_pushing":false,"can_rotate":false},"limits":{"guide_travel_mm":6,"guide_speed_mm_s":4,"guide_force_n":null,"push_speed_mm_s":5,"rotation_speed_deg_s":90},"max_depth_mm":120,"depth_step_mm":1,"tip_noise_mm":0.1,"tip_delay_s":0.2,"tip_rate_hz":10,"guide_error_mm":0.1,"bevel_deg":0,"extra":"ignored"}"#;
const ANSWER: &str = r#"{"t_s":0.1,"depth_mm":0,"guide_x_mm":0,"guide_y_mm":0,"bevel_deg":0,"tip_seq":0,"tip_x_mm":0,"tip_y_mm":0,"valid":false}"#;

/// Written bytes, for a test to read.
#[derive(Clone, Default)]
struct Kept(Arc<Mutex<Vec<u8>>>);

impl Write for Kept {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().expect("not poisoned").extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

impl Kept {
    fn text(&self) -> String {
        String::from_utf8(self.0.lock().expect("not poisoned").clone()).expect("text")
    }
}

/// No interrupt.
static NONE: AtomicBool = AtomicBool::new(false);

/// The fault of a shell script as a plant, and what was recorded.
fn fault(script: &str) -> (SteerError, String) {
    let written = Kept::default();
    let arguments = ["-c".to_owned(), script.to_owned()];
    let mut plant =
        ProcessPlant::with_limits("sh", &arguments, Record::new(written.clone()), [0.5, 0.5], &NONE)
            .expect("starts");
    let fault = steer(&mut plant, &Options::new([1.0, 0.0, 50.0]), &mut |_| {}).expect_err("a fault");
    (fault, written.text())
}

/// A statement, then what is given as the answer to the first step.
fn answered(answer: &str) -> SteerError {
    fault(&format!("echo '{STATEMENT}'; read line; echo '{answer}'; read line; exit 2")).0
}

#[test]
fn every_error_of_a_plant_ends_the_run_by_its_name() {
    for (error, name, part) in [
        (answered(r#"{"error":"the needle broke"}"#), "plant_error", "the needle broke"),
        (answered("not json"), "plant_line_malformed", "line 2 of the plant is no answer"),
        (answered("[1,2]"), "plant_line_malformed", "not a JSON object"),
        (
            answered(&without_field(ANSWER, r#""depth_mm":0,"#)),
            "plant_line_malformed",
            "missing field `depth_mm`",
        ),
        (
            answered(&without_field(ANSWER, r#","valid":false"#)),
            "plant_line_malformed",
            "missing field `valid`",
        ),
        (answered(&ANSWER.replace(r#""tip_x_mm":0"#, r#""tip_x_mm":NaN"#)), "plant_line_malformed", "line 2"),
        (
            answered(&ANSWER.replace(r#""t_s":0.1"#, r#""t_s":0.3"#)),
            "plant_time",
            "expected the step's 0.1 s",
        ),
        (fault("sleep 3").0, "plant_silent", "no statement within 0.5 s"),
        (fault(&format!("echo '{STATEMENT}'; sleep 3")).0, "plant_silent", "no answer within 0.5 s"),
        (fault(&format!("echo '{STATEMENT}'; read line; exit 2")).0, "plant_ended", "expected answer"),
        (fault("exit 0").0, "plant_ended", "expected statement"),
        (
            fault(&format!("echo '{}'", STATEMENT.replace("needle/1", "needle/2"))).0,
            "plant_protocol",
            "needle/2",
        ),
        (
            fault(&format!("echo '{}'", STATEMENT.replace(r#""tip_rate_hz":10"#, r#""tip_rate_hz":0"#))).0,
            "plant_value",
            "tip_rate_hz of the plant is 0",
        ),
        (
            fault(&format!("echo '{}'", without_field(STATEMENT, r#""max_depth_mm":120,"#))).0,
            "plant_line_malformed",
            "missing field `max_depth_mm`",
        ),
    ] {
        assert_eq!(error.name(), name, "{error}");
        assert!(error.to_string().contains(part), "{error}: expected {part}");
    }
    // Whether the parser of JSON rejects it or passes it on as infinite depends on features that other packages of a build request.
    let error = answered(&ANSWER.replace(r#""tip_x_mm":0"#, r#""tip_x_mm":1e999"#));
    assert!(["plant_line_malformed", "plant_value"].contains(&error.name()), "{error}");
}

fn without_field(text: &str, field: &str) -> String {
    text.replace(field, "")
}

#[test]
fn nothing_is_sent_after_an_error() {
    // The plant writes what it still receives after its error.
    let folder = tempfile::tempdir().expect("a folder");
    let marker_file = folder.path().join("after");
    let script = format!(
        "echo '{STATEMENT}'; read line; echo '{{\"error\":\"x\"}}'; cat > '{}'",
        marker_file.display()
    );
    let (error, record) = fault(&script);
    assert_eq!(error.name(), "plant_error");
    assert_eq!(record.matches("{\"command\":").count(), 1, "{record}");
    assert_eq!(std::fs::read_to_string(marker_file).expect("read"), "");
}

#[test]
fn a_program_that_does_not_exist_is_an_error() {
    let error = ProcessPlant::start("/nowhere/plant", &[], Record::default(), &NONE).expect_err("an error");
    assert!(matches!(error, PlantError::NotStarted(_)), "{error}");
    assert!(error.to_string().contains("is the program installed"), "{error}");
}

#[test]
fn the_record_holds_every_line_in_order() {
    let (_, record) = fault(&format!("echo '{STATEMENT}'; read line; echo 'not json'; read line; exit 2"));
    let kinds: Vec<&str> = record.lines().map(|line| line.split('"').nth(1).expect("a kind")).collect();
    assert_eq!(kinds, ["plant", "command", "malformed"]);
    assert_eq!(record.lines().next().expect("a line"), format!("{{\"plant\":{STATEMENT}}}"));
}

#[test]
fn a_program_that_ends_at_once_is_reported_with_its_exit_code_and_a_remedy() {
    let (error, record) = fault("exit 7");
    let text = error.to_string();
    assert!(text.contains("exit status: 7") && text.contains("Run the command by itself"), "{text}");
    // A replay ends by the same.
    let options = serde_json::to_string(&Options::new([1.0, 0.0, 50.0])).expect("text");
    let mut replayed = ReplayPlant::new(&format!("{{\"options\":{options}}}\n{record}")).expect("a record");
    let again = steer(&mut replayed, &Options::new([1.0, 0.0, 50.0]), &mut |_| {}).expect_err("a fault");
    assert_eq!(again, error);
}

/// Ended by an interrupt while an answer is awaited, and before a command: the record has it, and a replay ends by the same.
#[test]
fn an_interrupt_is_no_end_of_the_plant_and_can_be_replayed() {
    for before_a_command in [false, true] {
        let interrupted: &'static AtomicBool = Box::leak(Box::new(AtomicBool::new(before_a_command)));
        let written = Kept::default();
        let record = Record::new(written.clone());
        let options = Options::new([1.0, 0.0, 50.0]);
        record.note("options", &options);
        // The first answer never comes.
        let arguments = ["-c".to_owned(), format!("echo '{STATEMENT}'; read line; sleep 1000")];
        let mut plant =
            ProcessPlant::with_limits("sh", &arguments, record, [1e3, 1e3], interrupted).expect("starts");
        let error = std::thread::scope(|scope| {
            let text = written.clone();
            scope.spawn(move || {
                while !before_a_command && !text.text().contains("\"command\"") {
                    std::thread::sleep(Duration::from_millis(5));
                }
                interrupted.store(true, Ordering::Release);
            });
            steer(&mut plant, &options, &mut |_| {}).expect_err("interrupted")
        });
        assert_eq!((error.name(), &error), ("interrupted", &SteerError::Plant(PlantError::Interrupted)));
        let text = written.text();
        assert_eq!(text.contains("\"command\""), !before_a_command, "{text}");
        let mut replayed = ReplayPlant::new(&text).expect("a record");
        assert_eq!(steer(&mut replayed, &options, &mut |_| {}), Err(error));
    }
}

/// An interrupt at the terminal goes to the whole process group of the foreground.
#[test]
fn a_plant_has_a_process_group_of_its_own() {
    let (error, _) = fault("ps -o pgid= -p $$ | grep -qw $$ && exit 7; exit 8");
    assert!(error.to_string().contains("exit status: 7"), "{error}");
}
