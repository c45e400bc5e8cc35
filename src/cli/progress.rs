//! Progress on the terminal: a bar for each stage, or plain lines where there is no terminal.

use std::io::IsTerminal;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::pipeline::Progress;

/// Where progress is shown.
pub(super) struct TerminalProgress {
    style: Style,
    current: Mutex<Option<Running>>,
}

#[derive(Clone, Copy, PartialEq)]
enum Style {
    Bars,
    Lines,
    Silent,
}

struct Running {
    stage: String,
    begun: Instant,
    bar: ProgressBar,
}

impl TerminalProgress {
    pub(super) fn new(quiet: bool) -> Self {
        let style = if quiet {
            Style::Silent
        } else if std::io::stderr().is_terminal() {
            Style::Bars
        } else {
            Style::Lines
        };
        Self {
            style,
            current: Mutex::new(None),
        }
    }

    /// Ends the running stage.
    pub(super) fn finish(&self) {
        self.replace(None);
    }

    /// Progress of a stage that counts on its own: done and total.
    pub(super) fn counter(&self, stage: &'static str) -> Counter<'_> {
        Counter {
            progress: self,
            stage,
            done: 0,
            has_begun: false,
        }
    }

    fn replace(&self, next: Option<Running>) {
        let Ok(mut current) = self.current.lock() else {
            return;
        };
        if let Some(done) = current.take() {
            let seconds = done.begun.elapsed().as_secs_f64();
            match self.style {
                Style::Bars => {
                    done.bar.finish_and_clear();
                    print_line(&format!("{:<34} {seconds:>7.2} s", done.stage));
                }
                Style::Lines => print_line(&format!("{:<34} {seconds:>7.2} s", done.stage)),
                Style::Silent => {}
            }
        }
        *current = next;
    }
}

/// See [`TerminalProgress::counter`].
pub(super) struct Counter<'a> {
    progress: &'a TerminalProgress,
    stage: &'static str,
    done: u64,
    has_begun: bool,
}

impl Counter<'_> {
    pub(super) fn at(&mut self, done: u64, total: u64) {
        if !self.has_begun {
            self.progress.begin(self.stage, total);
            self.has_begun = true;
        }
        self.progress.advance(done.saturating_sub(self.done));
        self.done = self.done.max(done);
    }
}

impl Progress for TerminalProgress {
    fn begin(&self, stage: &str, num_steps: u64) {
        let bar = if self.style == Style::Bars {
            let bar = ProgressBar::with_draw_target(
                (num_steps > 0).then_some(num_steps),
                ProgressDrawTarget::stderr(),
            );
            let template = if num_steps > 0 {
                "{msg:<34} {wide_bar:.cyan/blue} {pos}/{len} {elapsed}"
            } else {
                "{msg:<34} {spinner} {pos} {elapsed}"
            };
            if let Ok(style) = ProgressStyle::with_template(template) {
                bar.set_style(style);
            }
            bar.set_message(stage.to_owned());
            bar.enable_steady_tick(Duration::from_millis(200));
            bar
        } else {
            ProgressBar::hidden()
        };
        self.replace(Some(Running {
            stage: stage.to_owned(),
            begun: Instant::now(),
            bar,
        }));
    }

    fn advance(&self, num_steps: u64) {
        if let Ok(current) = self.current.lock()
            && let Some(running) = current.as_ref()
        {
            running.bar.inc(num_steps);
        }
    }
}

#[expect(
    clippy::print_stderr,
    reason = "progress goes to the terminal, beside the product"
)]
fn print_line(line: &str) {
    eprintln!("{line}");
}
