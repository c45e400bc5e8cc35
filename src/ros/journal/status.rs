//! How the journal is, for diagnostics.

use std::path::{Path, PathBuf};

use crate::bag::journal::{JournalError, JournalReport};
use crate::ros::diagnostics::{Finding, Level};

/// How the journal is.
#[derive(Clone, Debug, Default)]
pub(in crate::ros) struct JournalStatus {
    path: PathBuf,
    /// Keyframes that it is to hold.
    pub(in crate::ros) num_keyframes: usize,
    /// Keyframes that the run before left in it.
    pub(in crate::ros) num_resumed: usize,
    /// States of the scan that newer ones replaced before they were written.
    pub(in crate::ros) num_coalesced: u64,
    pub(in crate::ros) report: JournalReport,
    /// What of the run before was not whole.
    pub(in crate::ros) losses: Vec<String>,
    /// Why it is behind, and the remedy.
    pub(in crate::ros) problem: Option<String>,
}

impl JournalStatus {
    pub(super) fn new(path: Option<&Path>) -> Self {
        Self {
            path: path.map(Path::to_owned).unwrap_or_default(),
            ..Self::default()
        }
    }

    /// No journal is kept in this run.
    pub(super) fn give_up(&mut self, error: &JournalError) {
        self.problem = Some(format!(
            "no journal is kept: {error}; {}, then start anew",
            error.remedy()
        ));
    }

    /// What came of the last write.
    pub(super) fn note(&mut self, result: Result<(), JournalError>) {
        self.problem = result.err().map(|error| {
            format!(
                "{error}; {} of {} keyframes are safe; {}",
                self.report.num_keyframes,
                self.num_keyframes,
                error.remedy()
            )
        });
    }

    /// Keyframes that it does not hold yet.
    pub(in crate::ros) fn num_pending(&self) -> usize {
        self.num_keyframes.saturating_sub(self.report.num_keyframes)
    }
}

/// The journal's part of `/diagnostics`.
pub(in crate::ros) fn finding(status: &JournalStatus) -> Finding {
    let report = &status.report;
    let value = |key: &str, number: u64| (key.to_owned(), number.to_string());
    let values = vec![
        ("path".to_owned(), status.path.display().to_string()),
        value("acknowledged steps", report.num_acknowledged),
        value("acknowledged keyframes", report.num_keyframes as u64),
        value("acknowledged mesh updates", report.num_mesh_updates),
        value("pending keyframes", status.num_pending() as u64),
        value("resumed keyframes", status.num_resumed as u64),
        value("states coalesced", status.num_coalesced),
        value("bytes", report.num_bytes),
        value("dead bytes", report.num_dead_bytes),
        value("compactions", report.num_compactions),
        value("failures", report.num_failures),
    ];
    let (level, message) = if let Some(problem) = &status.problem {
        (Level::Error, problem.clone())
    } else if status.losses.is_empty() {
        let words = format!("{} keyframes are safe", report.num_keyframes);
        (Level::Ok, words)
    } else {
        let words = format!(
            "what the run before left was damaged: {}",
            status.losses.join("; ")
        );
        (Level::Warn, words)
    };
    Finding {
        level,
        part: "journal",
        message,
        values,
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Error, ErrorKind};

    use super::*;

    #[test]
    fn a_full_disk_is_told_with_path_words_and_remedy() {
        let mut status = JournalStatus::new(Some(Path::new("/scans/a.mcap")));
        status.num_keyframes = 7;
        status.report.num_keyframes = 4;
        assert_eq!(finding(&status).level, Level::Ok);
        status.note(Err(JournalError::Io {
            path: "/scans/a.mcap".into(),
            action: "write",
            error: Error::from(ErrorKind::StorageFull),
        }));
        let told = finding(&status);
        assert_eq!(told.level, Level::Error);
        let full = Error::from(ErrorKind::StorageFull).to_string();
        for words in ["/scans/a.mcap", &full, "free some space", "4 of 7"] {
            assert!(told.message.contains(words), "'{words}': {}", told.message);
        }
        let pending = told
            .values
            .iter()
            .find(|(key, _)| key == "pending keyframes");
        assert_eq!(pending.unwrap().1, "3");
        status.note(Ok(()));
        assert_eq!(finding(&status).level, Level::Ok);
    }

    #[test]
    fn what_was_lost_is_told_until_the_end() {
        let mut status = JournalStatus::new(Some(Path::new("a.mcap")));
        status.losses = vec!["a.mcap: at byte 9 a step is cut off".to_owned()];
        status.note(Ok(()));
        let told = finding(&status);
        assert_eq!(told.level, Level::Warn);
        assert!(told.message.contains("byte 9"), "{}", told.message);
    }
}
