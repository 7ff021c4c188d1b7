//! Requests of the page.

use crate::blocks::BlocksRequest;
use crate::plan::PlanRequest;
use crate::play::PlayInput;
use crate::tables::TableRequest;
use serde::Deserialize;
use serde::de::Error;
use serde_json::{Map, Value};
use std::path::PathBuf;

/// Field with the name of the request.
const NAME: &str = "do";

/// A request; its name is in the field `do`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Request {
    /// The catalogue of effects.
    Effects {},
    /// Faults of a session, and its possible uses.
    Check {
        /// Folder of the session.
        dir: PathBuf,
    },
    /// Measurements, for drawing.
    Session {
        /// Folder of the session.
        dir: PathBuf,
    },
    /// The tissue's modulus.
    Identify {
        /// Folder of the session.
        dir: PathBuf,
        /// Relation that converts K to Young's modulus; by default that of the program, which takes longest.
        #[serde(default)]
        relation: Option<String>,
        /// `springs` or `body`; by default that of the session, else by evidence. K is the same with both, and is found sooner with
        /// springs.
        #[serde(default)]
        foundation: Option<String>,
    },
    /// Effects that the model lacks.
    Diagnose {
        /// Folder of the session.
        dir: PathBuf,
    },
    /// Steps of the investigation of a session, where there was one.
    Investigation {
        /// Folder of the session.
        dir: PathBuf,
    },
    /// The tip's path.
    Predict {
        /// Folder of the session.
        dir: PathBuf,
        /// Depth up to which insertions are observed.
        until_mm: f64,
        /// Text of the model file of a diagnosis; by default the plain model.
        #[serde(default)]
        model: Option<String>,
    },
    /// The model fitted with these effects.
    Try {
        /// Folder of the session.
        dir: PathBuf,
        /// `springs` or `body`.
        foundation: String,
        /// Ids.
        effects: Vec<String>,
    },
    /// Expected interval of a run, over depth and displacement.
    Plan(PlanRequest),
    /// K/E over the size of a block of tissue.
    Blocks(BlocksRequest),
    /// The record of the session for statistics over many.
    Summarize {
        /// Folder of the session.
        dir: PathBuf,
    },
    /// Common properties of many sessions.
    Population {
        /// Files of records.
        files: Vec<PathBuf>,
        /// Labels that the groups are formed by.
        #[serde(default)]
        by: Vec<String>,
    },
    /// Bytes of the device since the last time, as they went over the link.
    Follow {
        /// File with the bytes.
        file: PathBuf,
        /// The first of a connection.
        #[serde(default)]
        fresh: bool,
    },
    /// The frame for a device at a serial port of the browser: a greeting, or with the token of its answer the request for samples. There is
    /// none for anything that moves.
    Ask {
        /// Number of the command.
        id: u16,
        /// Token of the connection.
        #[serde(default)]
        connection: Option<u32>,
    },
    /// Response of a needle to the sliders.
    Play(PlayInput),
    /// Content of foreign tables, and the session that they become.
    Table(TableRequest),
}

impl Request {
    /// Reads a request.
    ///
    /// Not by serde's own tag in a field: that does not read numbers where another crate of the build has enabled numbers of any
    /// precision in `serde_json`.
    ///
    /// # Errors
    /// The text is no JSON object, or not one of the requests with its fields.
    pub fn parse(text: &str) -> Result<Self, serde_json::Error> {
        let mut fields: Map<String, Value> = serde_json::from_str(text)?;
        let Some(Value::String(name)) = fields.remove(NAME) else {
            return Err(serde_json::Error::custom("expected the name of a request in the field `do`"));
        };
        serde_json::from_value(Value::Object(Map::from_iter([(name, Value::Object(fields))])))
    }
}
