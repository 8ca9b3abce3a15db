//! Languages that code is written in, and generated files.

/// A language of generated code.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CodeLanguage {
    /// C99, with a header that C++ reads too.
    C,
    /// Rust without crates.
    Rust,
    /// Python 3 without packages.
    Python,
}

impl CodeLanguage {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::C, Self::Rust, Self::Python];

    /// Name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::C => "c",
            Self::Rust => "rust",
            Self::Python => "python",
        }
    }
}

/// A generated file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SourceFile {
    /// Name without a folder.
    pub name: String,
    /// Content.
    pub text: String,
}
