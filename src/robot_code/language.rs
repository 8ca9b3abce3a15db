//! Languages that code is written in, and generated files.

armwatch_model::named_enum! {
    /// A language of generated code.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum CodeLanguage {
        /// C99, with a header that C++ reads too.
        C = "c",
        /// Rust without crates.
        Rust = "rust",
        /// Python 3 without packages.
        Python = "python",
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
