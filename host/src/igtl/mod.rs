//! Messages to clients over OpenIGTLink: [`scene`] has the messages, [`live`] when they are sent.

pub mod live;
pub mod scene;

pub use live::Live;
pub use scene::Scene;
