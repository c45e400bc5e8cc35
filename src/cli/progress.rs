//! Progress on the terminal: a bar for each stage, or plain lines where there is no terminal.

use std::io::IsTerminal;
use std::path::PathBuf;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::export::atomic;
use crate::export::pages::jpeg_rgb8;
use crate::geom::ColorImage;
use crate::pipeline::Progress;
use crate::texsmooth::StepProgress;

/// Where progress is shown.
pub(super) struct TerminalProgress {
    style: Style,
    current: Mutex<Option<Running>>,
    /// Where previews go.
    preview: Option<PathBuf>,
    /// Where checkpoints go.
    checkpoint: Option<PathBuf>,
}

const PREVIEW_QUALITY: u8 = 90;

/// Lines of losses between the beginning and the end, where there is no terminal.
const NUM_LOSS_LINES: usize = 20;

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
            preview: None,
            checkpoint: None,
        }
    }

    /// Also writes previews and checkpoints to files, each over the one before.
    pub(super) fn with_files(self, preview: Option<PathBuf>, checkpoint: Option<PathBuf>) -> Self {
        Self {
            preview,
            checkpoint,
            ..self
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

    fn losses(&self, at: &StepProgress) {
        let text = || {
            let losses = &at.losses;
            format!(
                "L1 {:.4} (λ {:.2}), −log D {:.3}, D: real {:.3}, fake {:.3}",
                losses.l1, at.lambda, losses.adversarial, losses.real, losses.fake
            )
        };
        match self.style {
            Style::Silent => {}
            Style::Bars => {
                if let Ok(current) = self.current.lock()
                    && let Some(running) = current.as_ref()
                {
                    running.bar.set_message(text());
                }
            }
            Style::Lines => {
                let interval = at.num_steps.div_ceil(NUM_LOSS_LINES).max(1);
                if at.num_done.is_multiple_of(interval) {
                    print_line(&format!(
                        "  step {}/{}: {}",
                        at.num_done,
                        at.num_steps,
                        text()
                    ));
                }
            }
        }
    }

    fn preview(&self, num_steps: usize, image: &ColorImage) {
        if let Some(path) = &self.preview
            && let Err(error) = write_picture(path, image)
        {
            tracing::warn!(num_steps, path = %path.display(), %error, "preview not written");
        }
    }

    fn checkpoint(&self, num_steps: usize, bytes: &[u8]) {
        if let Some(path) = &self.checkpoint
            && let Err(error) = write_bytes(path, bytes)
        {
            tracing::warn!(num_steps, path = %path.display(), %error, "checkpoint not written");
        }
    }
}

fn write_picture(path: &std::path::Path, image: &ColorImage) -> anyhow::Result<()> {
    let rgb = image.pixels().as_flattened();
    let bytes = jpeg_rgb8(image.width(), image.height(), rgb, PREVIEW_QUALITY)
        .map_err(anyhow::Error::msg)?;
    write_bytes(path, &bytes)
}

fn write_bytes(path: &std::path::Path, bytes: &[u8]) -> anyhow::Result<()> {
    atomic::write_atomic(path, |out| out.write_all(bytes))?;
    Ok(())
}

#[expect(
    clippy::print_stderr,
    reason = "progress goes to the terminal, beside the product"
)]
fn print_line(line: &str) {
    eprintln!("{line}");
}
