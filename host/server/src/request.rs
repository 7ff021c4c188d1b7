//! Requests of the page over the socket.

use serde::Deserialize;

/// Longest jog along either axis, millimetres.
pub const MAX_JOG_MM: f64 = 1.0;

/// A request.
#[derive(Debug, Clone, PartialEq)]
pub enum Request {
    /// End any motion: every page may.
    Stop,
    /// Control, where no other page has it.
    Take,
    /// No control any more.
    Leave,
    /// The update of this number has been drawn.
    Heartbeat(u64),
    /// Move to where the needle is straight.
    Home,
    /// Make the present force zero.
    Tare,
    /// Leave the fault state.
    Clear,
    /// Move out of the load that has caused the fault.
    Retreat,
    /// Move by so much along x and y, millimetres.
    Jog([f64; 2]),
    /// Run the program of this name.
    Run(String),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Message {
    #[serde(rename = "do")]
    action: String,
    update: Option<u64>,
    x_mm: Option<f64>,
    y_mm: Option<f64>,
    program: Option<String>,
}

impl Request {
    /// Reads a message; none where it is not one of the page's.
    pub fn read(text: &str) -> Option<Self> {
        let Message { action, update, x_mm, y_mm, program } = serde_json::from_str(text).ok()?;
        match (action.as_str(), update, x_mm, y_mm, program) {
            ("stop", None, None, None, None) => Some(Self::Stop),
            ("take", None, None, None, None) => Some(Self::Take),
            ("leave", None, None, None, None) => Some(Self::Leave),
            ("home", None, None, None, None) => Some(Self::Home),
            ("tare", None, None, None, None) => Some(Self::Tare),
            ("clear", None, None, None, None) => Some(Self::Clear),
            ("retreat", None, None, None, None) => Some(Self::Retreat),
            ("heartbeat", Some(update), None, None, None) => Some(Self::Heartbeat(update)),
            ("jog", None, Some(x_mm), Some(y_mm), None) => [x_mm, y_mm]
                .iter()
                .all(|value| value.is_finite() && value.abs() <= MAX_JOG_MM)
                .then_some(Self::Jog([x_mm, y_mm])),
            ("run", None, None, None, Some(program)) => Some(Self::Run(program)),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_are_read_and_others_are_rejected() {
        assert_eq!(Request::read(r#"{"do":"stop"}"#), Some(Request::Stop));
        assert_eq!(Request::read(r#"{"do":"heartbeat","update":7}"#), Some(Request::Heartbeat(7)));
        assert_eq!(Request::read(r#"{"do":"jog","x_mm":-0.1,"y_mm":1}"#), Some(Request::Jog([-0.1, 1.0])));
        let named = Request::Run("displace".to_owned());
        assert_eq!(Request::read(r#"{"do":"run","program":"displace"}"#), Some(named));
        for wrong in [
            "",
            "stop",
            "{}",
            "[]",
            r#"{"do":"go"}"#,
            r#"{"do":"stop","x_mm":1}"#,
            r#"{"do":"stop","now":true}"#,
            r#"{"do":"jog","x_mm":1}"#,
            r#"{"do":"jog","x_mm":1.001,"y_mm":0}"#,
            r#"{"do":"jog","x_mm":1e999,"y_mm":0}"#,
            r#"{"do":"jog","x_mm":null,"y_mm":0}"#,
            r#"{"do":"heartbeat","update":-1}"#,
            r#"{"do":"run"}"#,
        ] {
            assert_eq!(Request::read(wrong), None, "{wrong}");
        }
    }
}
