//! A stream painted and refined as it goes on, by the stream's own time.

use super::super::live::LiveScan;
use super::super::progress::Progress;
use super::super::run::{PipelineError, PipelineParams};
use super::{StreamPainter, Streamed};
use crate::geom::Stamp;
use crate::ingest::EventSource;

/// Paints a stream as it comes: whenever keyframes or mesh changed and `period_s` of the stream's time
/// went by since the last time, and once more at its end. Where nothing changed for `period_s` there is
/// an idle step ([`StreamPainter::refine_some`]) every `period_s`, and at the end as many as there is
/// work for. `see` is shown every update and every step.
///
/// # Errors
/// [`PipelineError`] of the first update that failed, and when the stream held nothing to paint.
pub fn stream(
    source: &mut dyn EventSource,
    params: &PipelineParams,
    period_s: f64,
    progress: &dyn Progress,
    see: &mut dyn FnMut(&StreamPainter, &Streamed),
) -> Result<StreamPainter, PipelineError> {
    let mut painter = painted_to_the_end(source, params, period_s, progress, see)?;
    while let Some(step) = painter.refine_some(params, progress)? {
        see(&painter, &step);
    }
    Ok(painter)
}

/// [`stream()`] without the idle steps at the end.
///
/// # Errors
/// As [`stream()`].
pub(super) fn painted_to_the_end(
    source: &mut dyn EventSource,
    params: &PipelineParams,
    period_s: f64,
    progress: &dyn Progress,
    see: &mut dyn FnMut(&StreamPainter, &Streamed),
) -> Result<StreamPainter, PipelineError> {
    let mut driver = Driver {
        scan: LiveScan::new(params, source.topics(), 0),
        painter: StreamPainter::new(&params.keyframe),
        params,
        progress,
        see,
        painted: None,
    };
    while let Some(event) = source.next_event() {
        let now = event.received;
        let has_changed = driver.scan.push(event);
        let Some(last) = &driver.painted else {
            if has_changed {
                driver.paint()?;
            }
            continue;
        };
        let has_new = last.revision != driver.scan.revision() || driver.painter.num_waiting() > 0;
        let since = if has_new { last.at } else { last.refined_at };
        if now.seconds_since(since) < period_s {
            continue;
        }
        if has_new {
            driver.paint()?;
        } else {
            driver.refine_at(now)?;
        }
    }
    driver.scan.flush();
    let revision = driver.painted.as_ref().map(|last| last.revision);
    if revision != Some(driver.scan.revision()) {
        driver.paint()?;
    }
    while driver.painter.num_waiting() > 0 {
        driver.paint()?;
    }
    match driver.painted {
        Some(_) => Ok(driver.painter),
        None if driver.scan.capture().mesh.is_none() => {
            Err(PipelineError::NoMesh("none has arrived".to_owned()))
        }
        None => Err(PipelineError::NoKeyframe("none was kept".to_owned())),
    }
}

struct Driver<'a> {
    scan: LiveScan,
    painter: StreamPainter,
    params: &'a PipelineParams,
    progress: &'a dyn Progress,
    see: &'a mut dyn FnMut(&StreamPainter, &Streamed),
    painted: Option<LastPainted>,
}

struct LastPainted {
    at: Stamp,
    /// When it was painted, or refined since.
    refined_at: Stamp,
    revision: u64,
}

impl Driver<'_> {
    fn paint(&mut self) -> Result<(), PipelineError> {
        let capture = self.scan.capture();
        if !capture.is_paintable() {
            return Ok(());
        }
        self.painted = Some(LastPainted {
            at: capture.stamp,
            refined_at: capture.stamp,
            revision: capture.revision,
        });
        let streamed = self.painter.paint(capture, self.params, self.progress)?;
        (self.see)(&self.painter, &streamed);
        Ok(())
    }

    /// An idle step, where there is work for one; the next is a period later.
    fn refine_at(&mut self, now: Stamp) -> Result<(), PipelineError> {
        if self.refine()?
            && let Some(last) = &mut self.painted
        {
            last.refined_at = now;
        }
        Ok(())
    }

    fn refine(&mut self) -> Result<bool, PipelineError> {
        let Some(step) = self.painter.refine_some(self.params, self.progress)? else {
            return Ok(false);
        };
        (self.see)(&self.painter, &step);
        Ok(true)
    }
}
