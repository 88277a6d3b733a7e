//! Line charts and dot plots as SVG text: one style for every figure, colours that colour-blind readers can tell apart
//! (Okabe and Ito's, without the yellow), and a dash pattern where colours run out.
use crate::error::{Error, Result};
use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;

const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(148, 103, 20),
    RGBColor(90, 90, 90),
];
const INK: RGBColor = RGBColor(40, 40, 40);
const GRID: RGBColor = RGBColor(225, 225, 225);
const FONT: &str = "sans-serif";
const WIDTH: u32 = 920;
const PANEL_HEIGHT: u32 = 270;

/// How a line is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Look {
    /// Number n of the systems: colour and dashes follow.
    System(usize),
    /// What really was.
    Truth,
}

/// One curve.
#[derive(Clone, Debug)]
pub struct Line {
    /// What the curve is called.
    pub name: String,
    /// What decides its colour and dashes.
    pub look: Look,
    /// The points (x, y) that it joins.
    pub points: Vec<(f64, f64)>,
    /// Lower and upper end of each point's interval; empty for none.
    pub intervals: Vec<(f64, f64)>,
    /// Dots at the points.
    pub dots: bool,
}

impl Line {
    /// A curve without dots and intervals.
    pub fn new(name: impl Into<String>, look: Look, points: Vec<(f64, f64)>) -> Self {
        Self {
            name: name.into(),
            look,
            points,
            intervals: Vec::new(),
            dots: false,
        }
    }

    /// With a dot at every point.
    pub fn dotted(mut self) -> Self {
        self.dots = true;
        self
    }

    /// With the lower and upper end of an interval at every point.
    pub fn with_intervals(mut self, intervals: Vec<(f64, f64)>) -> Self {
        self.intervals = intervals;
        self
    }
}

/// One pair of axes.
#[derive(Clone, Debug, Default)]
pub struct Panel {
    /// What stands over the axes.
    pub title: String,
    /// Label of the horizontal axis.
    pub x: String,
    /// Label of the vertical axis.
    pub y: String,
    /// The curves drawn between the axes.
    pub lines: Vec<Line>,
}

type Canvas<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Drawing on a string cannot fail but for a chart without room.
fn drawn<E: std::error::Error + Send + Sync>(error: DrawingAreaErrorKind<E>) -> Error {
    Error::Numbers(format!("cannot draw a figure: {error}"))
}

/// (colour, dash and gap in pixels; no gap: solid)
fn look(look: Look) -> (RGBColor, (u32, u32)) {
    match look {
        Look::Truth => (INK, (2, 3)),
        Look::System(n) => (
            COLOURS[n % COLOURS.len()],
            [(1, 0), (7, 4), (3, 2)][n / COLOURS.len() % 3],
        ),
    }
}

/// Range of finite values with a little room; never empty.
fn range(values: impl Iterator<Item = f64>, room: f64) -> std::ops::Range<f64> {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for v in values.filter(|v| v.is_finite()) {
        low = low.min(v);
        high = high.max(v);
    }
    if low > high {
        return 0.0..1.0;
    }
    let pad = if high > low {
        room * (high - low)
    } else {
        0.5 * high.abs().max(1.0)
    };
    low - pad..high + pad
}

fn tick(v: f64) -> String {
    let text = match v.abs() {
        a if a >= 1e4 => format!("{:.0} k", v / 1e3),
        a if a >= 10.0 => format!("{v:.0}"),
        _ => format!("{v:.2}"),
    };
    let zeros = text.contains('.') && !text.contains('k');
    if zeros {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

/// Panels side by side, `columns` in a row.
pub fn panels(label: &str, panels: &[Panel], columns: usize) -> Result<String> {
    let columns = columns.clamp(1, panels.len().max(1));
    let rows = panels.len().div_ceil(columns).max(1);
    svg(label, (WIDTH, PANEL_HEIGHT * rows as u32), |root| {
        for (panel, area) in panels.iter().zip(root.split_evenly((rows, columns))) {
            chart(panel, &area)?;
        }
        Ok(())
    })
}

fn chart(panel: &Panel, area: &Canvas) -> Result<()> {
    let xs = panel.lines.iter().flat_map(|l| l.points.iter().map(|p| p.0));
    let ys = panel.lines.iter().flat_map(|l| {
        let ends = l.intervals.iter().flat_map(|i| [i.0, i.1]);
        l.points.iter().map(|p| p.1).chain(ends)
    });
    let mut chart = ChartBuilder::on(area)
        .caption(&panel.title, (FONT, 14).into_font().color(&INK))
        .margin(8)
        .x_label_area_size(34)
        .y_label_area_size(52)
        .build_cartesian_2d(range(xs, 0.02), range(ys, 0.06))
        .map_err(drawn)?;
    chart
        .configure_mesh()
        .light_line_style(WHITE)
        .bold_line_style(GRID)
        .axis_style(INK)
        .x_desc(&panel.x)
        .y_desc(&panel.y)
        .x_labels(7)
        .y_labels(6)
        .x_label_formatter(&|v| tick(*v))
        .y_label_formatter(&|v| tick(*v))
        .label_style((FONT, 11).into_font().color(&INK))
        .axis_desc_style((FONT, 12).into_font().color(&INK))
        .draw()
        .map_err(drawn)?;
    for line in &panel.lines {
        curve(&mut chart, line)?;
    }
    Ok(())
}

type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

fn curve(chart: &mut Chart, line: &Line) -> Result<()> {
    let (colour, (dash, gap)) = look(line.look);
    let style = colour.stroke_width(2);
    let points = || {
        line.points
            .iter()
            .copied()
            .filter(|p| p.0.is_finite() && p.1.is_finite())
    };
    if gap == 0 {
        chart
            .draw_series(LineSeries::new(points(), style))
            .map_err(drawn)?;
    } else {
        let points: Vec<(f64, f64)> = points().collect();
        chart
            .draw_series(DashedLineSeries::new(points, dash, gap, style))
            .map_err(drawn)?;
    }
    for (&(x, _), &(low, high)) in line.points.iter().zip(&line.intervals) {
        let whisker = PathElement::new(vec![(x, low), (x, high)], colour.stroke_width(1));
        chart.draw_series([whisker]).map_err(drawn)?;
    }
    if line.dots {
        let dots = points().map(|p| Circle::new(p, 3, colour.filled()));
        chart.draw_series(dots).map_err(drawn)?;
    }
    Ok(())
}

/// One row a system: a dot with its interval.
pub fn dots(label: &str, x: &str, rows: &[(String, f64, f64, f64)]) -> Result<String> {
    let height = 60 + 22 * rows.len() as u32;
    let longest = rows.iter().map(|r| r.0.chars().count()).max().unwrap_or(0) as u32;
    svg(label, (WIDTH, height), |root| {
        let xs = rows.iter().flat_map(|r| [r.1, r.2, r.3]);
        let mut chart = ChartBuilder::on(root)
            .margin(8)
            .x_label_area_size(34)
            .y_label_area_size((20 + 6 * longest).min(420))
            .build_cartesian_2d(range(xs, 0.04), (rows.len() as f64 - 0.4)..-0.6)
            .map_err(drawn)?;
        let name = |v: &f64| {
            let row = v.round();
            let at = (row - v).abs() < 1e-6 && row >= 0.0;
            rows.get(row as usize)
                .filter(|_| at)
                .map_or(String::new(), |r| r.0.clone())
        };
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .bold_line_style(GRID)
            .axis_style(INK)
            .disable_y_mesh()
            .x_desc(x)
            .x_labels(8)
            .y_labels(rows.len() * 2 + 1)
            .x_label_formatter(&|v| tick(*v))
            .y_label_formatter(&name)
            .label_style((FONT, 12).into_font().color(&INK))
            .draw()
            .map_err(drawn)?;
        for (n, (_, value, low, high)) in rows.iter().enumerate() {
            let y = n as f64;
            let whisker = PathElement::new(vec![(*low, y), (*high, y)], COLOURS[0].stroke_width(2));
            chart.draw_series([whisker]).map_err(drawn)?;
            chart
                .draw_series([Circle::new((*value, y), 4, COLOURS[0].filled())])
                .map_err(drawn)?;
        }
        Ok(())
    })
}

/// A sample of a line and its name, for a legend in HTML.
pub fn key(name: &str, of: Look) -> String {
    let (colour, (dash, gap)) = look(of);
    let dashes = if gap == 0 {
        String::new()
    } else {
        format!(" stroke-dasharray=\"{dash} {gap}\"")
    };
    format!(
        "<span class=\"key\"><svg width=\"28\" height=\"10\" aria-hidden=\"true\"><line x1=\"1\" y1=\"5\" x2=\"27\" y2=\"5\" \
         stroke=\"rgb({},{},{})\" stroke-width=\"2.5\"{dashes}/></svg>{}</span>",
        colour.0,
        colour.1,
        colour.2,
        escape(name)
    )
}

/// Text inside HTML.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

fn svg(label: &str, size: (u32, u32), draw: impl FnOnce(&Canvas) -> Result<()>) -> Result<String> {
    let mut text = String::new();
    {
        let root = SVGBackend::with_string(&mut text, size).into_drawing_area();
        root.fill(&WHITE).map_err(drawn)?;
        draw(&root)?;
        root.present().map_err(drawn)?;
    }
    // Inside HTML the name space goes without saying; the page names nothing outside itself.
    let text = text.replace(" xmlns=\"http://www.w3.org/2000/svg\"", "");
    let label = format!("<svg role=\"img\" aria-label=\"{}\"", escape(label));
    Ok(text.replacen("<svg", &label, 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_where_its_points_are() {
        let line = Line::new(
            "a & b",
            Look::System(0),
            vec![(0.0, 0.0), (1.0, 1.0), (2.0, f64::NAN)],
        )
        .dotted();
        let panel = Panel {
            title: "<one>".into(),
            lines: vec![line],
            ..Panel::default()
        };
        let text = panels("a \"figure\"", &[panel.clone(), panel], 2).unwrap();
        assert!(text.starts_with(
            "<svg role=\"img\" aria-label=\"a &quot;figure&quot;\" width=\"920\" height=\"270\""
        ));
        assert!(!text.contains("http") && !text.contains("NaN"));
        assert!(text.contains("&lt;one&gt;") && text.trim_end().ends_with("</svg>"));
        // Two dots a panel; the one with the greater value stands higher.
        let heights: Vec<i32> = text
            .split("<circle ")
            .skip(1)
            .map(|c| {
                c.split_once("cy=\"")
                    .unwrap()
                    .1
                    .split('"')
                    .next()
                    .unwrap()
                    .parse()
                    .unwrap()
            })
            .collect();
        assert_eq!(heights.len(), 4);
        assert!(heights[1] < heights[0] && heights[3] < heights[2]);
    }

    #[test]
    fn nothing_and_constants_can_be_drawn() {
        assert!(panels("empty", &[], 3).is_ok());
        assert!(panels("empty", &[Panel::default()], 3).is_ok());
        let flat = Line::new("flat", Look::Truth, vec![(1.0, 5.0)]);
        let panel = Panel {
            lines: vec![flat],
            ..Panel::default()
        };
        assert!(panels("flat", &[panel], 1).is_ok());
        assert!(dots("none", "x", &[]).is_ok());
    }

    #[test]
    fn every_system_of_twenty_looks_different() {
        let looks: std::collections::HashSet<_> = (0..21)
            .map(|n| look(Look::System(n)))
            .map(|(c, d)| ((c.0, c.1, c.2), d))
            .collect();
        assert_eq!(looks.len(), 21);
    }

    #[test]
    fn dots_are_named() {
        let rows = vec![
            ("first".to_owned(), 1.0, 0.5, 1.5),
            ("second".to_owned(), 2.0, 1.5, 2.5),
        ];
        let text = dots("d", "ACC", &rows).unwrap();
        assert!(text.contains("first") && text.contains("second"));
        assert_eq!(text.matches("<circle").count(), 2);
    }
}
