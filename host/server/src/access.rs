//! Who is answered: the token of the address, and the hosts and origins that are accepted.

use crate::http::{Head, Status};
use rand::TryRng;
use rand::rngs::SysRng;
use std::fmt::{self, Display};
use std::net::SocketAddr;

/// Random bytes of a token.
const TOKEN_BYTES: usize = 16;

/// The secret part of the address: 128 bits of the system's randomness.
#[derive(Clone)]
pub struct Token(String);

impl Token {
    /// Another one at every start.
    ///
    /// # Errors
    /// Where the system gives no randomness.
    pub fn random() -> std::io::Result<Self> {
        let mut bytes = [0u8; TOKEN_BYTES];
        SysRng.try_fill_bytes(&mut bytes).map_err(|error| std::io::Error::other(error.to_string()))?;
        Ok(Self(bytes.iter().map(|byte| format!("{byte:02x}")).collect()))
    }

    /// Whether this is the token, in a time that does not depend on where it differs.
    fn is(&self, candidate: &str) -> bool {
        let (own_token, candidate_bytes) = (self.0.as_bytes(), candidate.as_bytes());
        let differing = own_token.iter().zip(candidate_bytes).fold(0u8, |all, (a, b)| all | (a ^ b));
        own_token.len() == candidate_bytes.len() && differing == 0
    }
}

impl Display for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// Secrets do not go into logs.
impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token")
    }
}

/// Credentials that a request must show.
#[derive(Debug, Clone)]
pub struct Access {
    token: Token,
    hosts: [String; 2],
}

impl Access {
    /// For a server at this address.
    pub fn new(token: Token, address: SocketAddr) -> Self {
        let port = address.port();
        Self { token, hosts: [format!("127.0.0.1:{port}"), format!("localhost:{port}")] }
    }

    /// The address to open.
    pub fn url(&self) -> String {
        let [host, _] = &self.hosts;
        format!("http://{host}/{}/", self.token)
    }

    /// The part of the path behind the token.
    ///
    /// # Errors
    /// The status of the rejection.
    pub fn admit<'h>(&self, head: &'h Head) -> Result<&'h str, Status> {
        if !self.hosts.iter().any(|host| Some(host.as_str()) == head.host.as_deref()) {
            return Err(Status::Forbidden);
        }
        let path = head.path.strip_prefix('/').ok_or(Status::NotFound)?;
        let (token, remaining_path) = path.split_once('/').ok_or(Status::NotFound)?;
        if !self.token.is(token) {
            return Err(Status::NotFound);
        }
        if head.origin.is_some() && !self.is_own_origin(head) {
            return Err(Status::Forbidden);
        }
        if head.method != "GET" {
            return Err(Status::MethodNotAllowed);
        }
        Ok(remaining_path)
    }

    /// Whether the request states an origin, and it is the server's own under the name that the request was made with.
    pub fn is_own_origin(&self, head: &Head) -> bool {
        let own_origin = head.host.as_ref().map(|host| format!("http://{host}"));
        own_origin.is_some() && head.origin == own_origin
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn head(path: &str, host: Option<&str>, origin: Option<&str>) -> Head {
        let text = |value: Option<&str>| value.map(str::to_owned);
        Head {
            method: "GET".to_owned(),
            path: path.to_owned(),
            host: text(host),
            origin: text(origin),
            websocket_key: None,
        }
    }

    fn access() -> (Access, String) {
        let token = Token::random().expect("randomness");
        let text = token.to_string();
        (Access::new(token, SocketAddr::from(([127, 0, 0, 1], 8_000))), text)
    }

    #[test]
    fn a_token_is_another_one_at_every_start() {
        let [a, b] = [0, 1].map(|_| Token::random().expect("randomness").to_string());
        assert_eq!((a.len(), b.len()), (32, 32));
        assert_ne!(a, b);
    }

    #[test]
    fn what_shows_the_token_and_a_known_host_is_admitted() {
        let (access, token) = access();
        assert_eq!(access.url(), format!("http://127.0.0.1:8000/{token}/"));
        for host in ["127.0.0.1:8000", "localhost:8000"] {
            assert_eq!(access.admit(&head(&format!("/{token}/"), Some(host), None)), Ok(""));
            let own_origin = format!("http://{host}");
            let request = head(&format!("/{token}/a/b"), Some(host), Some(&own_origin));
            assert_eq!(access.admit(&request), Ok("a/b"));
        }
    }

    #[test]
    fn a_wrong_token_is_not_found_wherever_it_differs() {
        let (access, token) = access();
        let changed = |at: usize| {
            let mut bytes = token.clone().into_bytes();
            bytes[at] = if bytes[at] == b'0' { b'1' } else { b'0' };
            String::from_utf8(bytes).expect("ASCII")
        };
        for guess in [String::new(), changed(0), changed(31), token[..31].to_owned(), format!("{token}0")] {
            let request = head(&format!("/{guess}/"), Some("127.0.0.1:8000"), None);
            assert_eq!(access.admit(&request), Err(Status::NotFound), "{guess}");
        }
        assert_eq!(access.admit(&head("/", Some("127.0.0.1:8000"), None)), Err(Status::NotFound));
    }

    #[test]
    fn a_name_that_was_bound_to_this_machine_later_is_rejected() {
        let (access, token) = access();
        let hosts = ["evil.example:8000", "127.0.0.1", "127.0.0.1:8001", "localhost", "127.0.0.1:8000.evil"];
        for host in hosts.map(Some).into_iter().chain([None]) {
            let request = head(&format!("/{token}/"), host, None);
            assert_eq!(access.admit(&request), Err(Status::Forbidden), "{host:?}");
        }
    }

    #[test]
    fn a_page_of_another_origin_is_rejected_even_with_the_token() {
        let (access, token) = access();
        let foreign_origins =
            ["http://evil.example", "null", "https://127.0.0.1:8000", "http://localhost:8000", ""];
        for origin in foreign_origins {
            let request = head(&format!("/{token}/"), Some("127.0.0.1:8000"), Some(origin));
            assert_eq!(access.admit(&request), Err(Status::Forbidden), "{origin}");
        }
    }

    #[test]
    fn other_methods_are_rejected() {
        let (access, token) = access();
        for method in ["POST", "PUT", "DELETE", "OPTIONS", "HEAD", "get"] {
            let request = Head {
                method: method.to_owned(),
                ..head(&format!("/{token}/"), Some("localhost:8000"), None)
            };
            assert_eq!(access.admit(&request), Err(Status::MethodNotAllowed), "{method}");
        }
    }
}
