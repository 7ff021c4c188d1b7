//! Forms of indenters.

/// Form of an indenter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Indenter {
    /// A flat cylindrical punch.
    #[default]
    Flat,
    /// A sphere.
    Sphere,
}

impl Indenter {
    /// Every form.
    pub const ALL: [Self; 2] = [Self::Flat, Self::Sphere];

    /// Its name in files and results.
    pub fn name(self) -> &'static str {
        match self {
            Self::Flat => "flat",
            Self::Sphere => "sphere",
        }
    }
}
