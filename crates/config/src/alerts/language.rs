//! Languages of messages, pages and reports.

/// A language for people. Names in SQL, JSON and the log are English in all of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Language {
    /// English.
    #[default]
    English,
    /// Italian.
    Italian,
    /// German.
    German,
    /// Chinese in simplified characters.
    Chinese,
}

impl Language {
    /// All languages, in the order of the columns of the table of messages.
    pub const ALL: [Self; 4] = [Self::English, Self::Italian, Self::German, Self::Chinese];

    /// ISO 639 code, as in the configuration.
    pub const fn code(self) -> &'static str {
        match self {
            Self::English => "en",
            Self::Italian => "it",
            Self::German => "de",
            Self::Chinese => "zh",
        }
    }
}
