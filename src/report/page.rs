//! The shell of a report: one HTML file, styled for screen and paper, no scripts, nothing fetched.

use crate::report::svg::escape;
use std::fmt::Write;

const STYLE: &str = "
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, 'Segoe UI', 'DejaVu Sans', sans-serif; color: #1c2026; background: #fff; margin: 2.2rem auto; max-width: 1120px; padding: 0 1.2rem; }
h1 { font-size: 1.55rem; margin: 0 0 .3rem; } h2 { font-size: 1.15rem; margin: 2rem 0 .6rem; }
p { max-width: 46rem; } .quiet { color: #565d66; }
table { border-collapse: collapse; margin: .6rem 0; font-variant-numeric: tabular-nums; }
th, td { padding: .32rem .8rem; text-align: right; border-bottom: 1px solid #e3e6ea; }
th { font-weight: 600; border-bottom: 2px solid #8a8f98; } th:first-child, td:first-child { text-align: left; padding-left: 0; }
.charts { display: grid; grid-template-columns: repeat(auto-fit, minmax(350px, 1fr)); gap: 1.2rem; }
figure { margin: 0; break-inside: avoid; } figure svg { width: 100%; height: auto; display: block; }
figcaption { color: #565d66; font-size: .85rem; }
@media print { body { margin: 0; max-width: none; font-size: 10pt; } .charts { grid-template-columns: repeat(2, 1fr); } h2 { break-after: avoid; } }
";

/// A page under construction.
#[derive(Debug, Clone)]
pub struct Page {
    body: String,
    title: String,
}

impl Page {
    /// A page with its heading.
    #[must_use]
    pub fn new(title: &str) -> Self {
        Self { body: format!("<h1>{}</h1>\n", escape(title)), title: title.to_owned() }
    }
    /// A second-level heading.
    pub fn heading(&mut self, text: &str) {
        // writing to a String cannot fail
        let _ = writeln!(self.body, "<h2>{}</h2>", escape(text));
    }
    /// A paragraph; what stands between two backticks is set as code.
    pub fn text(&mut self, text: &str) {
        let parts = escape(text);
        let parts: Vec<String> = parts
            .split('`')
            .enumerate()
            .map(|(k, part)| if k % 2 == 1 { format!("<code>{part}</code>") } else { part.to_owned() })
            .collect();
        let _ = writeln!(self.body, "<p>{}</p>", parts.concat());
    }
    /// A paragraph in the background.
    pub fn quiet(&mut self, text: &str) {
        let _ = writeln!(self.body, "<p class=\"quiet\">{}</p>", escape(text));
    }
    /// A table: the first column is text, the others are numbers.
    pub fn table<R: AsRef<[String]>>(&mut self, header: &[&str], rows: &[R]) {
        self.body.push_str("<table><thead><tr>");
        for h in header {
            let _ = write!(self.body, "<th>{}</th>", escape(h));
        }
        self.body.push_str("</tr></thead><tbody>\n");
        for row in rows {
            self.body.push_str("<tr>");
            for cell in row.as_ref() {
                let _ = write!(self.body, "<td>{}</td>", escape(cell));
            }
            self.body.push_str("</tr>\n");
        }
        self.body.push_str("</tbody></table>\n");
    }
    /// Drawings side by side, each with a caption.
    pub fn charts(&mut self, drawings: &[(String, String)]) {
        self.body.push_str("<div class=\"charts\">\n");
        for (svg, caption) in drawings {
            let _ = writeln!(self.body, "<figure>{svg}<figcaption>{}</figcaption></figure>", escape(caption));
        }
        self.body.push_str("</div>\n");
    }
    /// The whole file.
    #[must_use]
    pub fn html(&self) -> String {
        format!(
            "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">\
             <title>{}</title><style>{STYLE}</style></head><body>\n{}</body></html>\n",
            escape(&self.title),
            self.body
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn backticks_make_code() {
        let mut page = Page::new("x");
        page.text("run `a <b>` now");
        assert!(page.html().contains("<p>run <code>a &lt;b&gt;</code> now</p>"));
    }

    #[test]
    fn text_cannot_break_out() {
        let mut page = Page::new("<x>");
        page.text("<script>alert(1)</script>");
        page.table(&["a"], &[["1 & 2".to_owned()]]);
        let html = page.html();
        assert!(!html.contains("<script") && html.contains("1 &amp; 2") && html.contains("<h1>&lt;x&gt;</h1>"));
    }
}
