//! What an evaluation measured, as JSON and as Markdown.
//!
//! SSIM up, LPIPS, S3 and Grad down is better. What was not measured is `null`, an empty cell.

use serde::Serialize;

use crate::metrics::protocol::{MethodScore, ViewScores};

/// An evaluation of several methods on one scan.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct EvalReport {
    /// Program and version.
    pub generator: String,
    /// What to call the scan.
    pub title: String,
    /// Sentences about what was done and what is missing.
    pub notes: Vec<String>,
    /// Keyframes that painted, before a method chose among them.
    pub num_training_views: usize,
    /// Per held-out view.
    pub views: Vec<EvalView>,
    /// Per method: means over the views.
    pub methods: Vec<EvalMethod>,
    /// What the paper printed for its own scenes.
    pub published: Vec<PublishedRow>,
    /// Every parameter as it was before a method changed it.
    pub parameters: serde_json::Value,
}

/// One held-out view.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct EvalView {
    /// Its name.
    pub name: String,
    /// The keyframe's number.
    pub keyframe: u32,
    /// When the photo was taken, nanoseconds.
    pub stamp_ns: i64,
    /// Width and height of the photo as it was compared.
    pub size_px: [u32; 2],
    /// Turn between this view and the nearest that painted, degrees.
    pub nearest_training_deg: Option<f64>,
    /// Per method, in the order of [`EvalReport::methods`].
    pub scores: Vec<EvalScore>,
    /// The contact sheet, relative to the report.
    pub sheet: Option<String>,
}

/// The measures, of one view or their means.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct EvalMeasures {
    /// Structural similarity, Gaussian window.
    pub ssim: Option<f64>,
    /// Learned perceptual similarity.
    pub lpips: Option<f64>,
    /// Mean difference of the S3 maps of the masked cut.
    pub s3: Option<f64>,
    /// Mean difference of gradient norms, 0–255.
    pub grad: Option<f64>,
    /// Peak signal-to-noise ratio over the common pixels, dB.
    pub psnr: Option<f64>,
    /// Share of the view that has texture.
    pub coverage: Option<f64>,
    /// SSIM under the uniform window of the authors' program.
    pub ssim_uniform: Option<f64>,
    /// S3 with maps of the whole images, as in the authors' program.
    pub s3_whole: Option<f64>,
    /// Length of the offset by which the rendering was aligned, pixels.
    pub offset_px: Option<f64>,
}

/// One method on one view.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct EvalScore {
    /// The method.
    pub method: String,
    /// How the rendering was aligned: columns, rows.
    pub alignment_px: [f32; 2],
    /// Whether that offset was trusted; where not, it is zero.
    pub is_aligned: bool,
    /// The part of the photo that was compared: left, top, width, height.
    pub cut_px: [u32; 4],
    /// Share of that part that no method of its company leaves empty.
    pub common_share: f64,
    /// The measures.
    #[serde(flatten)]
    pub measures: EvalMeasures,
}

/// One method.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct EvalMethod {
    /// Its name.
    pub method: String,
    /// What it is.
    pub description: String,
    /// Keyframes that it painted from; `null` for a mesh made elsewhere.
    pub num_views: Option<usize>,
    /// Time to make its texture, seconds.
    pub seconds: Option<f64>,
    /// Means over the views.
    #[serde(flatten)]
    pub measures: EvalMeasures,
}

/// What the paper printed.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct PublishedRow {
    /// The method by our name, where we have it.
    pub method: String,
    /// The paper's name.
    pub name: String,
    /// Which scenes.
    pub scenes: String,
    /// SSIM, LPIPS, S3 and Grad.
    pub ssim_lpips_s3_grad: [f64; 4],
}

impl EvalScore {
    /// What was measured of `method`, the one at `index` of those that were compared.
    pub fn new(method: &str, scores: &ViewScores, index: usize) -> Option<Self> {
        let score: &MethodScore = scores.scores.get(index)?;
        // The sum turns −0 into 0.
        let [dx, dy] = score.alignment.offset_px.map(|offset| offset + 0.0);
        let cut = scores.cut;
        Some(Self {
            method: method.to_owned(),
            alignment_px: [dx, dy],
            is_aligned: score.alignment.is_trusted,
            cut_px: [cut.x, cut.y, cut.width, cut.height],
            common_share: scores.common_share,
            measures: EvalMeasures {
                ssim: score.ssim,
                lpips: score.lpips,
                s3: Some(score.s3),
                grad: Some(score.grad),
                psnr: score.psnr_db,
                coverage: Some(score.coverage),
                ssim_uniform: score.ssim_uniform,
                s3_whole: Some(score.s3_whole),
                offset_px: Some(f64::from(dx.hypot(dy))),
            },
        })
    }
}

type Field = fn(&mut EvalMeasures) -> &mut Option<f64>;

/// The measures: heading of the column, decimals, what it is.
const COLUMNS: [(&str, usize, Field); 9] = [
    ("SSIM ↑", 3, |m| &mut m.ssim),
    ("LPIPS ↓", 3, |m| &mut m.lpips),
    ("S3 ↓", 3, |m| &mut m.s3),
    ("Grad ↓", 3, |m| &mut m.grad),
    ("PSNR ↑ dB", 2, |m| &mut m.psnr),
    ("coverage", 3, |m| &mut m.coverage),
    ("SSIM 7×7 ↑", 3, |m| &mut m.ssim_uniform),
    ("S3 whole ↓", 3, |m| &mut m.s3_whole),
    ("offset px", 2, |m| &mut m.offset_px),
];

impl EvalMeasures {
    /// Means over views, each over those where it was measured.
    pub fn mean(of_views: &[Self]) -> Self {
        let mut mean = Self::default();
        for (_, _, field) in COLUMNS {
            let values: Vec<f64> = of_views
                .iter()
                .filter_map(|measures| *field(&mut { *measures }))
                .collect();
            if !values.is_empty() {
                *field(&mut mean) = Some(values.iter().sum::<f64>() / values.len() as f64);
            }
        }
        mean
    }

    fn cells(mut self) -> String {
        let cell = |(_, decimals, field): (&str, usize, Field)| match *field(&mut self) {
            Some(value) => format!(" {value:.decimals$} |"),
            None => "  |".to_owned(),
        };
        COLUMNS.map(cell).concat()
    }
}

impl EvalReport {
    /// Sets the methods' means from the views.
    pub fn set_means(&mut self) {
        for (index, method) in self.methods.iter_mut().enumerate() {
            let of_views: Vec<EvalMeasures> = self
                .views
                .iter()
                .filter_map(|view| Some(view.scores.get(index)?.measures))
                .collect();
            method.measures = EvalMeasures::mean(&of_views);
        }
    }

    /// The tables: means, what the paper printed, every view.
    pub fn to_markdown(&self) -> String {
        let heads = COLUMNS.map(|(head, ..)| format!(" {head} |")).concat();
        let rules = "---:|".repeat(COLUMNS.len());
        let mut text = format!("# {}\n\n", self.title);
        text += &self.summary_line();
        text += &format!("\n| method | views | time s |{heads}\n|---|---:|---:|{rules}\n");
        for method in &self.methods {
            let views = method.num_views.map_or(String::new(), |n| n.to_string());
            let time = method.seconds.map_or(String::new(), |s| format!("{s:.1}"));
            let cells = method.measures.cells();
            text += &format!("| `{}` | {views} | {time} |{cells}\n", method.method);
        }
        text += "\n";
        for method in &self.methods {
            text += &format!("- `{}`: {}\n", method.method, method.description);
        }
        for note in &self.notes {
            text += &format!("- {note}\n");
        }
        if !self.published.is_empty() {
            text += &self.published_table();
        }
        text +=
            &format!("\n## Views\n\n| view | nearest ° | method |{heads}\n|---|---:|---|{rules}\n");
        for view in &self.views {
            let angle = view
                .nearest_training_deg
                .map_or(String::new(), |angle| format!("{angle:.2}"));
            for score in &view.scores {
                let (name, cells) = (&view.name, score.measures.cells());
                text += &format!("| {name} | {angle} | `{}` |{cells}\n", score.method);
            }
        }
        text
    }

    fn summary_line(&self) -> String {
        let angles: Vec<f64> = self
            .views
            .iter()
            .filter_map(|view| view.nearest_training_deg)
            .collect();
        let range = match (
            angles.iter().copied().min_by(f64::total_cmp),
            angles.iter().copied().max_by(f64::total_cmp),
        ) {
            (Some(min), Some(max)) => {
                let mean = angles.iter().sum::<f64>() / angles.len() as f64;
                format!(" Turn to the nearest of those: mean {mean:.2}°, {min:.2}° to {max:.2}°.")
            }
            _ => String::new(),
        };
        format!(
            "{} held-out views; {} others paint.{range}\n",
            self.views.len(),
            self.num_training_views,
        )
    }

    fn published_table(&self) -> String {
        let mut text = "\n## Printed in the paper (other scenes)\n\n\
            | paper | scenes | SSIM ↑ | LPIPS ↓ | S3 ↓ | Grad ↓ | ours | SSIM | LPIPS | S3 | Grad |\n\
            |---|---|---:|---:|---:|---:|---|---:|---:|---:|---:|\n"
            .to_owned();
        for row in &self.published {
            let [ssim, lpips, s3, grad] = row.ssim_lpips_s3_grad;
            text += &format!(
                "| {} | {} | {ssim:.3} | {lpips:.3} | {s3:.3} | {grad:.3} |",
                row.name, row.scenes
            );
            let ours = self.methods.iter().find(|m| m.method == row.method);
            text += &match ours {
                Some(ours) => {
                    let m = &ours.measures;
                    let cell = |v: Option<f64>| v.map_or(String::new(), |v| format!("{v:.3}"));
                    let cells = [m.ssim, m.lpips, m.s3, m.grad].map(cell).join(" | ");
                    format!(" `{}` | {cells} |\n", ours.method)
                }
                None => " |  |  |  |  |\n".to_owned(),
            };
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measures(ssim: f64, lpips: Option<f64>) -> EvalMeasures {
        EvalMeasures {
            ssim: Some(ssim),
            lpips,
            ..EvalMeasures::default()
        }
    }

    #[test]
    fn means_run_over_what_was_measured() {
        let mean = EvalMeasures::mean(&[measures(0.5, None), measures(0.7, Some(0.2))]);
        assert!((mean.ssim.unwrap() - 0.6).abs() < 1e-12);
        assert_eq!(mean.lpips, Some(0.2));
        assert_eq!(mean.psnr, None);
    }

    #[test]
    fn tables_have_every_method_and_view() {
        let score = |method: &str, ssim| EvalScore {
            method: method.to_owned(),
            measures: measures(ssim, None),
            ..EvalScore::default()
        };
        let view = |name: &str, a, b| EvalView {
            name: name.to_owned(),
            nearest_training_deg: Some(a),
            scores: vec![score("t-only", a), score("other", b)],
            ..EvalView::default()
        };
        let method = |name: &str| EvalMethod {
            method: name.to_owned(),
            ..EvalMethod::default()
        };
        let mut report = EvalReport {
            title: "room".to_owned(),
            views: vec![view("one", 0.25, 0.5), view("two", 0.75, 1.0)],
            methods: vec![method("t-only"), method("other")],
            published: vec![PublishedRow {
                method: "t-only".to_owned(),
                name: "T only".to_owned(),
                scenes: "eleven".to_owned(),
                ssim_lpips_s3_grad: [0.51, 0.342, 0.141, 8.092],
            }],
            ..EvalReport::default()
        };
        report.set_means();
        assert_eq!(report.methods[1].measures.ssim, Some(0.75));
        let text = report.to_markdown();
        for part in [
            "| `t-only` |  |  | 0.500 |  |",
            "mean 0.50°, 0.25° to 0.75°",
            "| two | 0.75 | `other` | 1.000 |",
            "| T only | eleven | 0.510 | 0.342 | 0.141 | 8.092 | `t-only` | 0.500 |",
        ] {
            assert!(text.contains(part), "{part} in\n{text}");
        }
        // Every line of a table has its head's number of cells.
        let cells = |line: &str| line.matches('|').count();
        let tables: Vec<&str> = text.split("\n\n").filter(|p| p.starts_with('|')).collect();
        assert_eq!(tables.len(), 3);
        for table in tables {
            let mut lines = table.lines().filter(|line| line.starts_with('|'));
            let head = cells(lines.next().unwrap());
            assert!(lines.all(|line| cells(line) == head), "{table}");
        }
        let json = serde_json::to_value(&report).unwrap();
        assert_eq!(json["methods"][1]["ssim"], 0.75);
        assert_eq!(json["methods"][1]["lpips"], serde_json::Value::Null);
        assert_eq!(json["views"][0]["scores"][1]["method"], "other");
    }
}
