//! Draws the monitor. Every colour comes with a word or a sign of its own.

use super::super::status;
use super::view::{CHART_S, View};
use crate::model::{Bend, Geometry, Shape};
use crate::primitives::Mm;
use ratatui::Frame;
use ratatui::layout::Constraint::{Fill, Length};
use ratatui::layout::{Layout, Rect};
use ratatui::style::{Color, Style, Stylize};
use ratatui::text::{Line, Text};
use ratatui::widgets::canvas::{Canvas, Context, Points};
use ratatui::widgets::{Block, Borders, Paragraph, Wrap};

const RING: Color = Color::DarkGray;
const DESIRED: Color = Color::Yellow;
const ESTIMATE: Color = Color::Cyan;
/// Places of a piston on its bar.
const PLACES: usize = 7;

/// Points and words in the units of a picture, within bounds of x and y.
struct Picture {
    bounds: [[f64; 2]; 2],
    dots: Vec<(Color, Vec<(f64, f64)>)>,
    words: Vec<(f64, f64, &'static str)>,
}

/// Draws a view on the whole frame.
pub fn draw(frame: &mut Frame, view: &View) {
    let area = frame.area();
    if area.width < 40 || area.height < 12 {
        let text = Text::from("The monitor needs a terminal of\n40 × 12 characters.");
        return frame.render_widget(text, area);
    }
    let tall = u16::from(area.height > 19);
    let (one, five) = (Length(1), Length(5));
    let heights = [one, Fill(4), Fill(2 * tall), five, Fill(tall), one];
    let rows = Layout::vertical(heights).split(area);
    let columns = Layout::horizontal([Fill(1), Fill(1), Fill(2)]).split(rows[1]);
    draw_picture(frame, columns[0], "Tip", side(view, columns[0]));
    draw_picture(frame, columns[1], "Bend, ○ to ●", polar(view, columns[1]));
    draw_text(frame, columns[2], "Health", health(view));
    let (title, picture) = errors(view);
    draw_picture(frame, rows[2], &title, picture);
    let (title, text) = lines(view);
    draw_text(frame, rows[3], &title, text);
    let newest: Vec<&str> = view.events.iter().rev().map(String::as_str).collect();
    draw_text(frame, rows[4], "Events, newest first", newest.join("\n"));
    let head = match view.silent_s {
        Some(silent_s) => {
            frame.buffer_mut().set_style(area, Style::new().dark_gray());
            format!(" no answer for {silent_s:.1} s ").reversed()
        }
        None if view.status.fault.is_none() => format!(" {} ", view.mode()).reversed(),
        None => format!(" {} ", view.mode()).red().reversed(),
    };
    let source = format!("  {}", view.source);
    frame.render_widget(Line::from(vec![head, source.into()]), rows[0]);
    frame.render_widget(Line::raw(view.keys), rows[5]);
}

fn titled(title: &str) -> Block<'_> {
    Block::new().borders(Borders::TOP).title(title)
}

fn draw_text(frame: &mut Frame, area: Rect, title: &str, text: String) {
    let text = Paragraph::new(text).wrap(Wrap { trim: false });
    frame.render_widget(text.block(titled(title)), area);
}

fn draw_picture(frame: &mut Frame, area: Rect, title: &str, picture: Picture) {
    let paint = |canvas: &mut Context<'_>| {
        for (color, coords) in &picture.dots {
            canvas.draw(&Points::new(coords, *color));
        }
        for (x, y, word) in &picture.words {
            canvas.print(*x, *y, *word);
        }
    };
    let [x, y] = picture.bounds;
    let canvas = Canvas::default().x_bounds(x).y_bounds(y);
    frame.render_widget(canvas.paint(paint).block(titled(title)), area);
}

/// Bounds around (0, 0) in which a unit has the same length in both directions; `edge` is the nearest one.
fn square(area: Rect, edge: f64) -> [[f64; 2]; 2] {
    // a character is twice as high as wide, and one row holds the title
    let size = [area.width, 2 * area.height.max(2) - 2].map(f64::from);
    size.map(|length| edge * length / size[0].min(size[1]))
        .map(|end| [-end, end])
}

/// The bending section in a cabinet projection: direction 0° to the right, 90° to the back, the tip upwards.
fn side(view: &View, area: Rect) -> Picture {
    let length = view.status.length_mm.unwrap_or(20.0);
    let arc = |bend: Bend, every: usize| {
        let at = |k: usize| {
            let s = k as f64 / 200.0;
            let (bend, length) = (Bend(bend.0 * s), Mm(length * s));
            let at = Geometry::default().position(&Shape { bend, length });
            (at.x - 0.43 * at.y, at.z - 0.25 * at.y - 10.0)
        };
        (0..=200).step_by(every).map(at).collect()
    };
    let (desired, estimate) = (view.status.setpoint, view.status.estimate);
    let desired = desired.map(|pose| (DESIRED, arc(pose.bend(), 10)));
    let estimate = estimate.map(|pose| (ESTIMATE, arc(pose.bend(), 1)));
    Picture {
        bounds: square(area, 20.0),
        dots: desired.into_iter().chain(estimate).collect(),
        words: vec![(15.0, -10.0, "0°"), (6.5, -6.0, "90°")],
    }
}

/// Desired and estimated bend, in degrees, within rings of 30°, 60° and 90°.
fn polar(view: &View, area: Rect) -> Picture {
    let ring = |k: u32| {
        let (sin, cos) = (f64::from(k) / 20.0).sin_cos();
        [30.0, 60.0, 90.0].map(|bend| (bend * cos, bend * sin))
    };
    let mut words = vec![(90.0, 0.0, "0°"), (0.0, 90.0, "90°")];
    for (pose, sign) in [(view.status.setpoint, "○"), (view.status.estimate, "●")] {
        let at = pose.map(|pose| pose.bend().0.map(f64::to_degrees));
        words.extend(at.map(|at| (at.x, at.y, sign)));
    }
    Picture {
        bounds: square(area, 105.0),
        dots: vec![(RING, (0..126).flat_map(ring).collect())],
        words,
    }
}

/// The error of the last minute, and its title.
fn errors(view: &View) -> (String, Picture) {
    let errors = view.errors.iter().map(|(_, error)| *error);
    let largest = errors.fold(0.0, f64::max);
    // at least half a degree, so that noise stays small
    let end = largest.max(0.5);
    let now = view.errors.back().map_or(f64::NAN, |(_, error)| *error);
    let now = shown(now, 2);
    let title = format!("Error {now}°, up to {largest:.2}° in {CHART_S} s; scale 0 to {end:.1}°");
    let now_s = view.status.t;
    let dots = view.errors.iter().map(|(t_s, error)| (t_s - now_s, *error));
    let picture = Picture {
        bounds: [[-CHART_S, 0.0], [0.0, end]],
        dots: vec![(ESTIMATE, dots.collect())],
        words: vec![],
    };
    (title, picture)
}

fn health(view: &View) -> String {
    let mut rows = status::rows(&view.status);
    rows.retain(|(name, _)| !["mode", "pistons"].contains(name));
    let line = |(name, text)| format!("{name:<10}{text}\n");
    rows.into_iter().map(line).collect()
}

/// A figure, or a dash before there is one.
fn shown(x: f64, digits: usize) -> String {
    if x.is_nan() {
        "–".to_owned()
    } else {
        format!("{x:.digits$}")
    }
}

/// The pistons within their travel, and the gains within what the loop may learn; the title names what it has learned of the lag.
fn lines(view: &View) -> (String, String) {
    let status = &view.status;
    let within = |x: f64, least: f64, most: f64| {
        let mark = if x <= least || x >= most { '!' } else { ' ' };
        let [x, least, most] = [x, least, most].map(|x| shown(x, 2));
        format!("{x} in {least} to {most}{mark}")
    };
    let unknown = [[f64::NAN; 2]; 3];
    let (travel, k_epsilon, k_lambda_mm) = match &status.limits {
        Some(limits) => (limits.travel_mm, limits.k_epsilon, limits.k_lambda_mm),
        None => (f64::NAN, unknown, unknown),
    };
    let of = |all: Option<[f64; 3]>, i: usize| all.map_or(f64::NAN, |all| all[i]);
    let [lag, delay] = [status.lag_s, status.delay_s].map(|s| shown(s.unwrap_or(f64::NAN), 3));
    let title = format!("Lines, lag {lag} s, dead time {delay} s; ! at a limit");
    let mut text = "  piston, mm                k_epsilon             k_lambda, mm\n".to_owned();
    for i in 0..3 {
        let at = of(status.piston_mm, i);
        let place = ((at / travel + 1.0) / 2.0 * PLACES as f64) as usize;
        let mut bar = ["·"; PLACES];
        (bar[PLACES / 2], bar[place.min(PLACES - 1)]) = ("|", "█");
        let piston = within(at, -travel, travel);
        let gain = |now, [least, most]: [f64; 2]| within(of(now, i), least, most);
        let k_epsilon = gain(status.k_epsilon, k_epsilon[i]);
        let k_lambda = gain(status.k_lambda_mm, k_lambda_mm[i]);
        text += &format!("{} {piston:25} {k_epsilon:21} {k_lambda:21}", i + 1);
        text += &format!("{}\n", bar.concat());
    }
    (title, text)
}
