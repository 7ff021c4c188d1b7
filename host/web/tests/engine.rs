//! Requests of the page, answered natively: documents of the program, trials, the needle to play with, and every kind of wrong request.

#[path = "engine/scripts.rs"]
mod scripts;

use formats::session::{Session, SessionWriter, Setup, template};
use protocol::{
    CommandReceiver, Envelope, Fault, Hello, MAX_FRAME_TO_HOST, Message, Packer, Received, Request, Sample,
    State, Status, encode_envelope,
};
use serde_json::{Value, json};
use simulation::simulate::{Sensors, SimulationPlan};
use std::fs;
use std::path::Path;
use web::Engine;

fn answer(engine: &mut Engine, request: &Value) -> Value {
    serde_json::from_str(&engine.answer(&request.to_string(), |_| {})).expect("an answer is JSON")
}

fn ok(engine: &mut Engine, request: &Value) -> Value {
    let mut answer = answer(engine, request);
    assert!(answer.get("error").is_none(), "{answer}");
    answer["ok"].take()
}

fn error(request: &Value) -> String {
    answer(&mut Engine::default(), request)["error"].as_str().expect("an error").to_owned()
}

/// The example of `guide init --example`, with two lateral runs and two insertions.
fn example(folder: &Path) -> String {
    let plan_file = folder.join("plan.toml");
    fs::write(&plan_file, template::EXAMPLE_PLAN).expect("written");
    let setup = Setup::read(&plan_file).expect("a set-up");
    let mut plan = SimulationPlan::read(&plan_file, None).expect("a plan");
    plan.lateral = vec![plan.lateral[0].clone(), plan.lateral[2].clone()];
    plan.insertion.truncate(2);
    let simulated = plan.carry_out(&setup.rig, Sensors::new(&setup.noise), 1).expect("simulated");
    let dir = folder.join("example");
    let mut session = SessionWriter::open(&dir, &setup).expect("a session");
    simulated.write(&mut session).expect("written");
    dir.display().to_string()
}

#[test]
fn documents_are_those_of_the_program_with_figures() {
    let folder = tempfile::tempdir().expect("a folder");
    let dir = example(folder.path());
    let engine = &mut Engine::default();
    let check = ok(engine, &json!({"do": "check", "dir": dir}));
    assert_eq!(check["document"]["schema"], "guide.check/2");
    assert_eq!(check["document"]["usable"], true);
    let reply = ok(engine, &json!({"do": "identify", "dir": dir, "relation": "vesic"}));
    assert_eq!(reply["document"]["pooled"]["runs"], 2);
    assert_eq!(reply["figures"].as_array().map(Vec::len), Some(6));
    // K that is shown first is the one that the document has.
    let first =
        ok(engine, &json!({"do": "identify", "dir": dir, "relation": "vesic", "foundation": "springs"}));
    for shown in ["pooled", "runs"] {
        assert_eq!(first["document"][shown], reply["document"][shown]);
    }
    assert!(
        first["document"]["foundation"]["body"].is_null()
            && !reply["document"]["foundation"]["body"].is_null()
    );
    let path = ok(engine, &json!({"do": "predict", "dir": dir, "until_mm": 50}));
    assert_eq!(path["document"]["insertions"].as_array().map(Vec::len), Some(2));
    assert!(path["figures"][0]["svg"].as_str().is_some_and(|svg| svg.contains("<svg")));
    // With the model of a diagnosis, as `guide predict --model`.
    let model = "[model]\nformat = 1\n[[effect]]\nid = \"tissue.layers\"\n[effect.parameters.k_ratio]\nvalue = 2.0\n\
                 [effect.parameters.boundary_mm]\nvalue = 15.0\n";
    let with_layers = ok(engine, &json!({"do": "predict", "dir": dir, "until_mm": 50, "model": model}));
    assert!((load_n(&with_layers) - load_n(&path)).abs() > 1e-3);
    let misspelt =
        json!({"do": "predict", "dir": dir, "until_mm": 50, "model": model.replace("layers", "layer")});
    assert!(error(&misspelt).contains("model.toml:4"), "{}", error(&misspelt));
    let series = ok(engine, &json!({"do": "session", "dir": dir}));
    assert_eq!(series["lateral"][1]["depth_mm"], 40.0);
    let drawn = series["lateral"][0]["time_s"].as_array().map_or(0, Vec::len);
    assert!((2..=600).contains(&drawn), "{drawn}");
}

fn load_n(answer: &Value) -> f64 {
    answer["document"]["insertions"][0]["tip_force_n"].as_f64().expect("a load")
}

#[test]
fn switching_the_hidden_effect_on_shrinks_the_misfit() {
    let folder = tempfile::tempdir().expect("a folder");
    let dir = example(folder.path());
    let engine = &mut Engine::default();
    let plain = ok(engine, &trial_request(json!([]), &dir));
    let layers = ok(engine, &trial_request(json!(["tissue.layers"]), &dir));
    assert!(
        chi2_reduced(&layers) < 0.7 * chi2_reduced(&plain),
        "{} {}",
        chi2_reduced(&plain),
        chi2_reduced(&layers)
    );
    assert!(layers["log_evidence_gain"].as_f64().is_some_and(|gain| gain > 5.0));
    assert!(layers["held_out_points"].as_array().is_some_and(|points| !points.is_empty()));
    assert_eq!(ok(engine, &trial_request(json!([]), &dir)), plain);
}

fn chi2_reduced(trial: &Value) -> f64 {
    trial["learned"][1]["chi2_reduced"].as_f64().expect("a number")
}

fn trial_request(effects: Value, dir: &str) -> Value {
    json!({"do": "try", "dir": dir, "foundation": "springs", "effects": effects})
}

/// The numbers of the closed form: 1.2 mm at 16 kPa and 30 mm, 10 mm behind guide 2, take 1.3096 N.
#[test]
fn the_needle_to_play_with_is_that_of_the_forward_model() {
    let engine = &mut Engine::default();
    let mut request = json!({
        "do": "play", "k_kpa": 16, "depth_mm": 30, "displacement_mm": 1.2, "gap_mm": 10, "tip_load_n": 0.0
    });
    let plain = ok(engine, &request);
    assert!((force_n(&plain["with"]) / 1.309_563_697_895_257 - 1.0).abs() < 1e-9);
    assert!(plain["without"].is_null());
    // With play of 0.3 mm the needle follows over 0.9 mm.
    request["effects"] = json!({"rig.backlash": {"clearance_mm": 0.3}});
    let loose = ok(engine, &request);
    assert!((force_n(&loose["with"]) / force_n(&plain["with"]) - 0.75).abs() < 1e-9);
    assert_eq!(loose["without"], plain["with"]);
}

fn force_n(side: &Value) -> f64 {
    side["force_n"].as_f64().expect("a force")
}

/// The numbers are those of `guide plan --rig FILE --k-kpa 5 30 --depth-mm 20 40 --displacement-mm 1.2`: the same library.
#[test]
fn a_plan_is_narrower_where_more_is_displaced_and_states_what_breaks_a_limit() {
    let engine = &mut Engine::default();
    let mut request = json!({
        "do": "plan", "modulus_kpa": [5, 30], "depth_mm": [20, 40], "displacement_mm": [0.4, 1.2], "hold_s": 3,
        "force_limit_n": 4, "strain_limit_percent": 0.2, "deflection_limit_mm": 2.5
    });
    let reply = ok(engine, &request);
    assert_eq!(reply["document"]["schema"], "guide.plan/1");
    let choices = reply["document"]["choices"].as_array().expect("a list");
    assert_eq!(choices.len(), 4);
    assert!(
        half_width_percent(&choices[1]) < half_width_percent(&choices[0])
            && half_width_percent(&choices[3]) < half_width_percent(&choices[2])
    );
    assert!(choices.iter().all(|choice| choice["within_limits"] == true));
    request["force_limit_n"] = json!(0.01);
    let tight = ok(engine, &request);
    assert!(tight["document"]["best"].is_null());
    request["modulus_kpa"] = json!([30, 5]);
    assert!(error(&request).contains("modulus_kpa: 30 to 5"), "{}", error(&request));
}

fn half_width_percent(choice: &Value) -> f64 {
    choice["half_width_percent"].as_f64().expect("a number")
}

#[test]
fn blocks_have_k_over_e_over_their_size_and_a_figure() {
    let engine = &mut Engine::default();
    let reply = ok(engine, &json!({"do": "blocks", "depth_mm": 30, "poisson": 0.5}));
    let half_space = reply["document"]["half_space"].as_f64().expect("a number");
    assert!(
        all_hold(list("held", &reply), |ratio, half_space| ratio > half_space, half_space)
            && all_hold(list("free", &reply), |ratio, half_space| ratio < half_space, half_space)
    );
    assert!(reply["figures"][0]["svg"].as_str().is_some_and(|svg| svg.starts_with("<svg")));
    let deep = error(&json!({"do": "blocks", "depth_mm": 400, "poisson": 0.5}));
    assert!(deep.contains("depth_mm: 400, expected 10 to 150"), "{deep}");
    let odd = error(&json!({"do": "blocks", "depth_mm": 30, "poisson": 0.7}));
    assert!(odd.contains("poisson"), "{odd}");
}

fn all_hold(all: Vec<Value>, holds: fn(f64, f64) -> bool, half_space: f64) -> bool {
    !all.is_empty() && all.iter().all(|ratio| holds(ratio.as_f64().expect("a number"), half_space))
}

fn list(name: &str, reply: &Value) -> Vec<Value> {
    reply["document"][name].as_array().expect("a list").clone()
}

#[test]
fn records_of_sessions_become_a_population_with_figures() {
    let folder = tempfile::tempdir().expect("a folder");
    let dir = example(folder.path());
    let engine = &mut Engine::default();
    let record = ok(engine, &json!({"do": "summarize", "dir": dir}));
    assert_eq!(record["schema"], "needle.summary/1");
    let file = folder.path().join("all.jsonl");
    let lines = ["a", "b", "c"].map(|name| {
        let mut record = record.clone();
        record["session"] = json!(name);
        record["tissue"] = json!("gel");
        record.to_string()
    });
    fs::write(&file, lines.join("\n")).expect("written");
    let reply = ok(engine, &json!({"do": "population", "files": [file], "by": ["tissue"]}));
    assert_eq!(reply["document"]["schema"], "guide.population/2");
    assert_eq!(reply["document"]["groups"][0]["group"], "gel");
    assert!(reply["figures"].as_array().is_some_and(|all| all.len() >= 4));
    let wrong = error(&json!({"do": "population", "files": [file], "by": ["colour"]}));
    assert!(wrong.contains("colour"), "{wrong}");
    let gone = error(&json!({"do": "population", "files": ["gone.jsonl"]}));
    assert!(gone.contains("gone.jsonl"), "{gone}");
}

/// Frames of a device as they go over the link: a greeting, then a batch of samples per number.
fn frames(numbers: impl Iterator<Item = u32>) -> Vec<u8> {
    let mut bytes = Vec::new();
    push_message(0, Message::Hello(fake_device::hello()), &mut bytes);
    for number in numbers {
        let mut packer = Packer::new(1_000);
        for i in 0..20 {
            let t_us = 1_000 * u64::from(20 * number + i);
            let sample = Sample {
                position_counts: [0, 1_000],
                force_counts: [0, if i == 7 { 60_000 } else { 20_000 }],
                repeats_force: false,
            };
            packer.push(t_us, State::Idle, u8::MAX, 0, sample);
        }
        push_message(number, Message::Samples(packer.flush().expect("samples")), &mut bytes);
    }
    bytes
}

fn push_message(sequence: u32, message: Message, bytes: &mut Vec<u8>) {
    let mut buffer = [0; MAX_FRAME_TO_HOST];
    let frame = encode_envelope(&Envelope { boot_id: 7, sequence, message }, &mut buffer);
    bytes.extend_from_slice(frame.expect("encoded"));
}

#[test]
fn frames_of_the_device_are_decoded_and_what_is_missing_is_counted() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("frames");
    let engine = &mut Engine::default();
    let whole = frames(1..=50);
    // Cut anywhere, in the middle of a frame too.
    let (begin, tail) = whole.split_at(whole.len() / 2 + 3);
    follow(begin, true, &file, engine);
    let later_reply = follow(tail, false, &file, engine);
    assert_eq!(later_reply["samples"], 1_000);
    assert_eq!((&later_reply["samples_missing"], &later_reply["frames_missing"]), (&json!(0), &json!(0)));
    let columns = later_reply["columns"].as_array().expect("a list");
    // Twentieths of a second: from the one in which the first half ends, each once, to that of the last sample at 1.019 s.
    let indices: Vec<i64> = columns.iter().filter_map(|one| one["index"].as_i64()).collect();
    assert!(indices.windows(2).all(|pair| pair[1] == pair[0] + 1), "{indices:?}");
    assert!((9..=10).contains(&indices[0]) && indices.last() == Some(&20), "{indices:?}");
    // A spike of one sample stays; counts of 50 micronewtons and 1 micrometre.
    assert!(columns.iter().all(|one| one["high"][1] == 3.0 && one["low"][1] == 1.0 && one["high"][3] == 1.0));
    // Three of fifty missing, one damaged.
    let mut damaged = frames((1..=50).filter(|number| !(20..23).contains(number)));
    let last = damaged.len() - 10;
    // Never 0, which would end the frame there and make two of it.
    damaged[last] = damaged[last].checked_add(1).unwrap_or(1);
    let damaged_reply = follow(&damaged, true, &file, engine);
    assert_eq!(
        (&damaged_reply["frames_missing"], &damaged_reply["samples_missing"]),
        (&json!(3), &json!(60))
    );
    assert_eq!(damaged_reply["frames_corrupt"], 1);
    assert!(error(&json!({"do": "follow", "file": "gone"})).contains("file: gone"));
}

fn follow(bytes: &[u8], fresh: bool, file: &std::path::PathBuf, engine: &mut Engine) -> Value {
    fs::write(file, bytes).expect("written");
    ok(engine, &json!({"do": "follow", "file": file, "fresh": fresh}))
}

#[test]
fn a_device_at_a_port_of_the_browser_is_requested_for_samples_and_nothing_else() {
    let engine = &mut Engine::default();
    assert_eq!(requested(&json!({"do": "ask", "id": 3}), engine), (3, 0, Request::Hello));
    let request = json!({"do": "ask", "id": 4, "connection": 77});
    assert_eq!(requested(&request, engine), (4, 77, Request::Stream { enable: true }));
    assert!(error(&json!({"do": "ask", "id": 1, "request": "Run"})).contains("unknown field"));

    // Answers of the engine.
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("frames");
    let mut bytes = Vec::new();
    let status = Status { state: State::Faulted, fault: Some(Fault::Stall), ..fake_device::status() };
    for (sequence, message) in (0..).zip([Message::Connected { connection: 77 }, Message::Status(status)]) {
        let mut buffer = [0; MAX_FRAME_TO_HOST];
        let envelope = Envelope { boot_id: 7, sequence, message };
        bytes.extend_from_slice(encode_envelope(&envelope, &mut buffer).expect("encoded"));
    }
    fs::write(&file, &bytes).expect("written");
    let first_reply = ok(engine, &json!({"do": "follow", "file": file, "fresh": true}));
    assert_eq!((&first_reply["connection"], &first_reply["state"]), (&json!(77), &json!("Faulted")));
    assert_eq!(first_reply["fault"], json!({"number": Fault::Stall as u8, "name": "Stall"}));
    assert!(first_reply["other_version"].is_null());
    let mut buffer = [0; MAX_FRAME_TO_HOST];
    let hello = Hello { protocol_version: protocol::VERSION + 1, ..fake_device::hello() };
    let envelope = Envelope { boot_id: 7, sequence: 2, message: Message::Hello(hello) };
    fs::write(&file, encode_envelope(&envelope, &mut buffer).expect("encoded")).expect("written");
    let next_reply = ok(engine, &json!({"do": "follow", "file": file, "fresh": false}));
    assert_eq!(next_reply["other_version"], json!(protocol::VERSION + 1));
}

fn requested(request: &Value, engine: &mut Engine) -> (u16, u32, Request) {
    let frame: Vec<u8> = serde_json::from_value(ok(engine, request)).expect("bytes");
    match CommandReceiver::new().feed(&frame).next() {
        Some(Received::Frame(command)) => (command.id, command.connection, command.request),
        other => panic!("{other:?}"),
    }
}

#[test]
fn every_effect_of_the_catalogue_can_be_played_with() {
    let engine = &mut Engine::default();
    let catalogue = ok(engine, &json!({"do": "effects"}));
    for effect in catalogue.as_array().expect("a list") {
        let parameters = effect["parameters"].as_array().expect("a list").iter();
        let values: serde_json::Map<String, Value> = parameters
            .map(|info| (info["name"].as_str().unwrap_or_default().to_owned(), info["neutral"].clone()))
            .collect();
        let id = effect["id"].as_str().expect("an id");
        let request = json!({
            "do": "play", "k_kpa": 12, "depth_mm": 50, "displacement_mm": 1.5, "gap_mm": 10, "tip_load_n": 0.2,
            "effects": {id: values}
        });
        let reply = ok(engine, &request);
        assert!(
            reply["with"]["force_n"].as_f64().is_some_and(f64::is_finite),
            "{id}: {}",
            reply["with"]["force_n"]
        );
    }
}

#[test]
fn a_table_of_others_is_shown_asked_about_and_becomes_a_session() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("my run.csv");
    let mut text = "t;Weg;Kraft [mN]\n".to_owned();
    for row in 0..400 {
        let t = 0.05 * f64::from(row);
        let x = ((t - 4.0) / 2.0).clamp(0.0, 1.2);
        text += &format!("{t:.2};{x:.4};{:.2}\n", 2400.0 * x).replace('.', ",");
    }
    fs::write(&file, text).expect("written");
    let engine = &mut Engine::default();
    let first = ok(engine, &table_request(json!([]), json!({"depth_mm": 30}), &file));
    assert!(
        first["problem"].as_str().is_some_and(|problem| problem.contains("no unit is stated")),
        "{first}"
    );
    assert_eq!(first["files"], json!({}));
    assert_eq!(first["columns"][1]["name"], "Weg");
    assert_eq!(first["columns"][1]["values"], json!([0.0, 0.0, 0.0]));
    // Recognized columns are offered, and missing ones can be chosen.
    let maps = json!(["t=time_s:s", "Weg=displacement_y_mm:mm", "Kraft [mN]=force_y_n"]);
    let shallow = ok(engine, &table_request(maps.clone(), json!({}), &file));
    assert!(
        shallow["problem"].as_str().is_some_and(|problem| problem.contains("length of the needle")),
        "{shallow}"
    );
    let reply = ok(
        engine,
        &table_request(
            maps,
            json!({"depth_mm": 30, "rig": "[needle]\nyoungs_modulus_gpa = 200.0\nouter_diameter_mm = 1.5\ninner_diameter_mm = 1.0\n[rig]\nguide2_mm = 50.0\nentry_mm = 65.0\n"}),
            &file,
        ),
    );
    assert_eq!(reply["problem"], Value::Null, "{reply}");
    assert_eq!((&reply["kind"], &reply["rows"]), (&json!("lateral"), &json!(400)));
    assert_eq!(reply["taken"][2]["range"], json!([0.0, 2.88]));
    assert!(reply["map_file"].as_str().is_some_and(|map| map.contains("is = \"force_y_n\"")), "{reply}");
    let session = folder.path().join("session");
    fs::create_dir(&session).expect("a folder");
    for (name, text) in reply["files"].as_object().expect("files") {
        fs::write(session.join(name), text.as_str().expect("text")).expect("written");
    }
    let read = Session::read(&session).expect("reads");
    assert_eq!(
        (read.rig.guide2_m, read.lateral[0].id.as_str(), read.lateral[0].depth_m),
        (0.05, "my-run", 0.03)
    );
    let force = &read.lateral[0].force;
    assert_eq!(force.time_s.len(), 400);
    assert!(force.force_y_n.iter().zip(&force.displacement_y_m).all(|(f, x)| (f - 2400.0 * x).abs() < 1e-9));
    // The session opens in the page's other views, which say what it has not got.
    let identify = json!({"do": "identify", "dir": session, "relation": "vesic", "foundation": "springs"});
    assert!(error(&identify).contains("0 shape points inside the tissue"));
    assert!(error(&json!({"do": "table", "files": ["none.csv"]})).contains("none.csv: cannot read"));
    assert!(error(&table_request(json!(["Weg=push"]), json!({}), &file)).contains("is no quantity"));
    assert!(
        error(&table_request(json!([]), json!({"z_from": "tip"}), &file))
            .contains("expected guide1 or surface")
    );
}

fn table_request(maps: Value, more: Value, file: &std::path::PathBuf) -> Value {
    let mut request = json!({"do": "table", "files": [file], "maps": maps});
    request.as_object_mut().expect("an object").extend(more.as_object().expect("an object").clone());
    request
}

/// The page takes every table that the command line takes, and shows what it took for what.
#[test]
fn workbooks_arrays_and_bags_are_tables_of_the_page_too() {
    let script = include_str!("../page/tables.js");
    for ending in formats::foreign::ENDINGS {
        let is_taken = ["(", "|"].iter().any(|before| {
            [")", "|"].iter().any(|after| script.contains(&format!("{before}{ending}{after}")))
        });
        assert!(is_taken, "tables.js does not take .{ending}");
    }
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../formats/tests/data");
    let bag = ["/ft:force.y=force_y_n", "/joint_states:guide.position=displacement_y_mm:m"];
    for (name, maps, rows) in
        [("push.xlsx", &[][..], 60), ("mcap-zstd.mcap", &bag, 59), ("mcap-lz4.mcap", &bag, 59)]
    {
        let request = json!({"do": "table", "files": [data.join(name)], "maps": maps, "depth_mm": 30});
        let reply = ok(&mut Engine::default(), &request);
        assert_eq!((&reply["problem"], &reply["rows"]), (&Value::Null, &json!(rows)), "{name}: {reply}");
        assert!(reply["taken"].as_array().is_some_and(|taken| taken.len() >= 3), "{name}: {reply}");
    }
}

#[test]
fn wrong_requests_are_answered_with_one_line_that_names_what_is_valid() {
    let play = json!({"do": "play", "k_kpa": 0, "depth_mm": 30, "displacement_mm": 1, "gap_mm": 10, "tip_load_n": 0});
    for (request, expected) in [
        (json!({"do": "nothing"}), "unknown variant `nothing`"),
        (json!({"dir": "gone"}), "expected the name of a request in the field `do`"),
        (json!({"do": "check"}), "missing field `dir`"),
        (json!({"do": "identify", "dir": "gone"}), "gone/session.toml"),
        (json!({"do": "identify", "dir": "gone", "relation": "hooke"}), "gone/session.toml"),
        (json!({"do": "predict", "dir": "gone", "until_mm": 1}), "until_mm: 1, expected 5 to 500 mm"),
        (
            json!({"do": "try", "dir": "gone", "foundation": "sand", "effects": []}),
            "expected springs or body",
        ),
        (
            json!({"do": "try", "dir": "gone", "foundation": "body", "effects": ["x"]}),
            "expected the id of an effect",
        ),
        (
            json!({"do": "identify", "dir": "gone", "foundation": "sand"}),
            "foundation: sand, expected springs or body",
        ),
        (play, "k_kpa: 0, expected 0.1 to 1000"),
    ] {
        let line = error(&request);
        assert!(line.contains(expected) && !line.contains('\n'), "{request}: {line}");
    }
}

/// K of springs and E of a body are different quantities: the modulus of a trial is shown with its name.
#[test]
fn a_trial_names_its_modulus_by_its_foundation() {
    let folder = tempfile::tempdir().expect("a folder");
    let dir = example(folder.path());
    let engine = &mut Engine::default();
    let script = include_str!("../page/diagnose.js");
    assert!(!script.contains("`Modulus ${"), "a modulus without a name");
    for (foundation, name) in [("springs", "Foundation modulus K"), ("body", "modulus E")] {
        let request = json!({"do": "try", "dir": dir, "foundation": foundation, "effects": []});
        assert_eq!(ok(engine, &request)["foundation"], foundation);
        assert!(script.contains(name), "{name}");
    }
}

#[test]
fn an_investigation_is_that_of_the_log_and_none_without_one() {
    let folder = tempfile::tempdir().expect("a folder");
    let dir = folder.path().display().to_string();
    let request = json!({"do": "investigation", "dir": dir});
    assert_eq!(ok(&mut Engine::default(), &request), Value::Null);
    let log = json!({"schema": "guide.investigate/1", "end": "named", "steps": [{
        "runs": 1, "verdict": "adequate", "explanations": [{"effects": [], "probability": 0.9}], "unseen_probability": 0.2,
        "k_kpa": 12.0, "k_ci95_kpa": [11.0, 13.0], "realised_nats": null, "next": {"run": "x30-1", "what": "a staircase",
        "minutes": 0.5, "information_nats": 0.06, "modulus_nats": 0.1, "reasons": ["tissue.skin"]}}]});
    let file = folder.path().join("investigation.json");
    fs::write(&file, log.to_string()).expect("written");
    assert_eq!(ok(&mut Engine::default(), &request), log);
    fs::write(&file, "{}").expect("written");
    assert!(error(&request).contains("investigation.json:1:2"), "{}", error(&request));
}
