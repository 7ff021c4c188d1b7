//! Forms of indenters.

/// Form of an indenter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Indenter {
    /// A flat cylindrical punch.
    #[default]
    Flat,
    /// A sphere.
    Sphere,
    /// A cone.
    Cone,
}

impl Indenter {
    /// Every form.
    pub const ALL: [Self; 3] = [Self::Flat, Self::Sphere, Self::Cone];

    /// Its name in files and results.
    pub fn name(self) -> &'static str {
        match self {
            Self::Flat => "flat",
            Self::Sphere => "sphere",
            Self::Cone => "cone",
        }
    }
}
