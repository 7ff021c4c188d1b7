//! The files for clients in other languages, `protocol/spec/`: generated from the types and the golden bytes, and compared with them.
//!
//! `NEEDLE_GUIDE_WRITE_SPEC=1 cargo test -p protocol spec` writes them again.

use super::golden_commands::COMMANDS;
use super::golden_envelopes::ENVELOPES;
use super::{BUFFER, Golden, bytes};
use crate::{
    CODES_PER_KNOT, Command, DURATION_LIMIT_MS, Envelope, Fault, KNOTS, MAX_CALIBRATION, MAX_FRAME_TO_DEVICE,
    MAX_FRAME_TO_HOST, MAX_STEPS, Message, PIECE_BYTES, PULSE_DUTY_LIMIT_PERMILLE, PULSE_LIMIT_MS,
    RETREAT_LIMIT_UM, SILENCE_LIMIT_MS, SPEED_LIMIT_UM_S, START_LIMIT_US, Step, TARE_LIMIT_MS, VERSION,
    program_crc, schema_hash,
};
use postcard_schema::Schema;
use postcard_schema::schema::{DataModelType, DataModelVariant, NamedType, NamedValue};
use serde::Serialize;
use serde_json::{Map, Value, json};
use std::string::{String, ToString};
use std::vec::Vec;
use std::{format, fs, println};

const FOLDER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/spec");

/// Compares a file with its regenerated content, or writes it where `NEEDLE_GUIDE_WRITE_SPEC` is set.
fn is_current(name: &str, made: &str) {
    let path = format!("{FOLDER}/{name}");
    if std::env::var_os("NEEDLE_GUIDE_WRITE_SPEC").is_some() {
        fs::write(&path, made).expect("writes");
        println!("wrote {path}");
    }
    let committed = fs::read_to_string(&path).unwrap_or_default();
    assert!(
        committed == made,
        "{path} differs from the code: NEEDLE_GUIDE_WRITE_SPEC=1 cargo test -p protocol spec"
    );
}

fn text(value: &Value) -> String {
    serde_json::to_string_pretty(value).expect("JSON") + "\n"
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Describes a type by its name, and adds its fields to the list of all types.
fn describe(ty: &NamedType, all: &mut Map<String, Value>) -> Value {
    let of = |kind: &str, content: Value| json!({ kind: content });
    match ty.ty {
        DataModelType::Bool => "bool".into(),
        DataModelType::U8 => "u8".into(),
        DataModelType::I8 => "i8".into(),
        DataModelType::U16 => "u16".into(),
        DataModelType::U32 => "u32".into(),
        DataModelType::U64 => "u64".into(),
        DataModelType::I16 => "i16".into(),
        DataModelType::I32 => "i32".into(),
        DataModelType::I64 => "i64".into(),
        DataModelType::String => "string".into(),
        DataModelType::ByteArray => "bytes".into(),
        DataModelType::Option(inner) => of("option", describe(inner, all)),
        DataModelType::Tuple(items) | DataModelType::TupleStruct(items) => {
            of("tuple", items.iter().map(|item| describe(item, all)).collect())
        }
        DataModelType::NewtypeStruct(inner) => describe(inner, all),
        DataModelType::Struct(fields) => {
            if !all.contains_key(ty.name) {
                all.insert(ty.name.to_string(), Value::Null);
                let described = json!({ "struct": members(fields, all) });
                all.insert(ty.name.to_string(), described);
            }
            of("type", ty.name.into())
        }
        DataModelType::Enum(variants) => {
            if !all.contains_key(ty.name) {
                all.insert(ty.name.to_string(), Value::Null);
                let mut list = Vec::new();
                for (number, variant) in variants.iter().enumerate() {
                    let content = match variant.ty {
                        DataModelVariant::UnitVariant => Value::Null,
                        DataModelVariant::NewtypeVariant(inner) => json!({ "newtype": describe(inner, all) }),
                        DataModelVariant::StructVariant(fields) => json!({ "struct": members(fields, all) }),
                        DataModelVariant::TupleVariant(_) => unreachable!("no message has one"),
                    };
                    list.push(json!({ "number": number, "name": variant.name, "content": content }));
                }
                all.insert(ty.name.to_string(), json!({ "enum": list }));
            }
            of("type", ty.name.into())
        }
        other => unreachable!("no message has a {other:?}"),
    }
}

fn members(fields: &[&NamedValue], all: &mut Map<String, Value>) -> Value {
    fields.iter().map(|field| json!({ "name": field.name, "type": describe(field.ty, all) })).collect()
}

#[test]
fn the_schema_for_other_languages_is_current() {
    let mut definitions = Map::new();
    let (command, envelope) =
        (describe(Command::SCHEMA, &mut definitions), describe(Envelope::SCHEMA, &mut definitions));
    let [silence_least, silence_most] = SILENCE_LIMIT_MS;
    let schema = json!({
        "format": "needle-guide.protocol-schema/1",
        "version": VERSION,
        "schema_hash": hexadecimal(&schema_hash()),
        "to_device": command,
        "to_host": envelope,
        "longest_frame_bytes": { "to_device": MAX_FRAME_TO_DEVICE, "to_host": MAX_FRAME_TO_HOST },
        "limits": {
            "steps": MAX_STEPS,
            "speed_um_s": SPEED_LIMIT_UM_S,
            "duration_ms": DURATION_LIMIT_MS,
            "tare_ms": TARE_LIMIT_MS,
            "start_ahead_us": START_LIMIT_US,
            "retreat_um": RETREAT_LIMIT_UM,
            "pulse_ms": PULSE_LIMIT_MS,
            "pulse_duty_permille": PULSE_DUTY_LIMIT_PERMILLE,
            "silence_ms": [silence_least, silence_most],
        },
        "faults": Fault::ALL.map(|fault| json!({
            "number": fault as u8,
            "name": format!("{fault:?}"),
            "allows_retreat": fault.allows_retreat(),
            "may_come_of_calibration": fault.may_come_of_calibration(),
        })),
        "types": definitions,
    });
    is_current("schema.json", &text(&schema));
}

fn vectors<T: Serialize>(golden: &[Golden<T>], is_batch: impl Fn(&T) -> bool) -> Vec<Value> {
    let mut buffer = BUFFER;
    golden
        .iter()
        .map(|Golden { message, frame }| {
            let frame = hexadecimal(bytes(frame, &mut buffer).expect("golden bytes"));
            let message = message();
            let content = serde_json::to_value(&message).expect("JSON");
            match is_batch(&message) {
                true => json!({ "frame_hex": frame, "message": content }),
                false => json!({ "frame_hex": frame, "message": content, "is_batch": false }),
            }
        })
        .collect()
}

/// False for samples that cannot be unpacked.
fn is_batch(envelope: &Envelope) -> bool {
    !matches!(&envelope.message, Message::Samples(samples) if samples.unpack(1_000).is_err())
}

/// The chapter states the limits of a calibration.
#[test]
fn the_chapter_has_the_limits_of_a_calibration() {
    use crate::plausible::{FORCE_RANGE_LIMIT_MN, FULL_SCALE_TIMES, KNOT_STEP_UM, PLAY_LIMIT_UM};
    let chapter = fs::read_to_string(format!("{FOLDER}/protocol.md")).expect("the chapter").replace(',', "");
    let [least, most] = KNOT_STEP_UM;
    let [fewest, times] = FULL_SCALE_TIMES;
    for text in [
        format!("at most {MAX_CALIBRATION} bytes sent {PIECE_BYTES} at a time"),
        format!("between the {KNOTS} knots of a table at code 0 {CODES_PER_KNOT} and so on"),
        format!("by {least} to {most} um each; at most {PLAY_LIMIT_UM} um apart"),
        format!("| 1 to {FORCE_RANGE_LIMIT_MN} |"),
        format!("{fewest} to {times} times the rated range"),
    ] {
        assert!(chapter.contains(&text), "no {text}");
    }
}

#[test]
fn the_test_vectors_for_other_languages_are_current() {
    let stop = "000dac02d487cb8d0a05e9f3124700";
    let damaged = [
        (stop.replace("e9f3", "e9f2"), "a bit of the checksum"),
        (stop.replace("0a05", "0a06"), "a bit of the payload"),
        (stop.replacen("000d", "000e", 1), "a bit of the stuffing"),
        ("0001010100".to_string(), "too short for a checksum"),
    ];
    let programs = [
        std::vec![],
        std::vec![
            Step::Move { x_um: -1500, y_um: 1000, speed_um_s: 500 },
            Step::Hold { duration_ms: 5000 },
            Step::Tare { duration_ms: 1000 },
            Step::Ramp { x_um: 0, y_um: -200, duration_ms: 400 },
        ],
    ];
    let vectors = json!({
        "format": "needle-guide.protocol-vectors/1",
        "version": VERSION,
        "to_device": vectors(COMMANDS, |_| true),
        "to_host": vectors(ENVELOPES, is_batch),
        "rejected": damaged.map(|(frame_hex, what)| json!({ "frame_hex": frame_hex, "what": what })),
        "program_crc": programs.map(|steps| json!({ "steps": steps, "crc": program_crc(&steps) })),
    });
    is_current("vectors.json", &text(&vectors));
}

/// The chapter states the number and the name of every variant of these enums.
#[test]
fn the_chapter_names_every_number() {
    let chapter = fs::read_to_string(format!("{FOLDER}/protocol.md")).expect("the chapter");
    let mut definitions = Map::new();
    let _ = (describe(Command::SCHEMA, &mut definitions), describe(Envelope::SCHEMA, &mut definitions));
    let lists = [
        "Request",
        "Step",
        "Message",
        "Refusal",
        "Fault",
        "State",
        "ResetReason",
        "Outcome",
        "RetreatOutcome",
        "PulseOutcome",
    ];
    for list in lists {
        let variants = definitions[list]["enum"].as_array().expect("an enum");
        for variant in variants {
            let row = format!("| {} | `{}` |", variant["number"], variant["name"].as_str().expect("a name"));
            assert!(chapter.contains(&row), "{list}: no row {row}");
        }
    }
    assert!(chapter.contains(&format!("protocol, version {VERSION}")));
    assert!(chapter.contains(&format!(
        "at most {MAX_FRAME_TO_DEVICE} bytes to\nthe device and {MAX_FRAME_TO_HOST} from it"
    )));
}
