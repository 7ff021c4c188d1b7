//! The page `guide.html` on loopback, as `guide web` serves it.
//!
//! Only programs of this machine can connect, and only those that have the token of the address are answered. A page of another
//! origin is rejected by `Origin`, a name that was bound to this machine later (DNS rebinding) by `Host`.
//!
//! | module | does |
//! |---|---|
//! | [`access`] | the token, and which hosts and origins are accepted |
//! | [`page`] | the page with the policy of its served form |
//! | [`sessions`] | the sessions below a folder, and their files |
//! | [`http`] | requests and answers, bounded |
//! | [`listener`] | connections, bounded, each on its own thread |
//! | [`socket`] | the WebSocket of one page |
//! | [`request`], [`update`] | what a page sends and receives over it |
//! | [`control`] | which page may move the device, by its heartbeat |
//! | `folder` | files of a folder, opened through no link |
//! | `frames` | what the device sends, as it goes over the link, for every page |
//! | [`live`] | the device, and the supervision of the page that moves it |
//!
//! # Example
//!
//! A page and the sessions of a folder, at a free port, without a device:
//!
//! ```
//! use server::sessions::Sessions;
//! use server::{Page, ServedContent, Server};
//!
//! let folder = tempfile::tempdir()?;
//! let page = Page { text: "<p>a page".to_owned(), policy: "default-src 'none'".to_owned() };
//! let server = Server::start(ServedContent { page, sessions: Sessions::of(folder.path())?, feed: None }, 0)?;
//! assert!(server.url().starts_with("http://127.0.0.1:") && server.is_running());
//! # Ok::<(), std::io::Error>(())
//! ```
#![forbid(unsafe_code)]
#![deny(missing_docs)]

pub mod access;
pub mod control;
mod folder;
mod frames;
pub mod http;
pub mod listener;
pub mod live;
pub mod page;
pub mod request;
pub mod sessions;
pub mod socket;
pub mod update;

pub use listener::{ServedContent, Server};
pub use live::Live;
pub use page::Page;
