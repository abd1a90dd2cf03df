//! An HTML report: one self-contained file, styled for screen and paper, without scripts or external resources.

use crate::report::svg::escape;
use std::fmt::Display;

const STYLE: &str = include_str!("page.css");

/// A page under construction.
#[derive(Debug, Clone)]
pub struct Page(String);

impl Page {
    /// An empty page with a title and a first-level heading.
    pub fn new(title: &str) -> Self {
        let title = escape(title);
        Self(format!(
            "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">\
             <title>{title}</title><style>\n{STYLE}</style></head><body>\n<h1>{title}</h1>\n"
        ))
    }
    /// Adds a second-level heading.
    pub fn heading(&mut self, text: &str) {
        self.line(format_args!("<h2>{}</h2>", escape(text)));
    }
    /// Adds a paragraph; text between two backticks is set as code.
    pub fn text(&mut self, text: &str) {
        let part = |(k, part): (usize, &str)| match k % 2 {
            1 => format!("<code>{part}</code>"),
            _ => part.to_owned(),
        };
        let marked: String = escape(text).split('`').enumerate().map(part).collect();
        self.line(format_args!("<p>{marked}</p>"));
    }
    /// Adds a paragraph in muted colour.
    pub fn quiet(&mut self, text: &str) {
        self.line(format_args!("<p class=\"quiet\">{}</p>", escape(text)));
    }
    /// Adds a table, whose header has the names of the columns between bars; the first column is text, the others are numbers.
    pub fn table<R: AsRef<[String]>>(&mut self, header: &str, rows: impl IntoIterator<Item = R>) {
        let cell = |tag: &str, text: &str| format!("<{tag}>{}</{tag}>", escape(text));
        let head: String = header.split('|').map(|text| cell("th", text)).collect();
        self.line(format_args!("<table><thead><tr>{head}</tr></thead><tbody>"));
        for row in rows {
            let row: String = row.as_ref().iter().map(|text| cell("td", text)).collect();
            self.line(format_args!("<tr>{row}</tr>"));
        }
        self.line("</tbody></table>");
    }
    /// Adds what a program printed.
    pub fn output(&mut self, text: &str) {
        self.line(format_args!("<pre>{}</pre>", escape(text)));
    }
    /// Adds drawings side by side: (SVG, caption).
    pub fn charts<C: AsRef<str>>(&mut self, drawings: impl IntoIterator<Item = (String, C)>) {
        self.line("<div class=\"charts\">");
        for (svg, caption) in drawings {
            let caption = escape(caption.as_ref());
            self.line(format_args!(
                "<figure>{svg}<figcaption>{caption}</figcaption></figure>"
            ));
        }
        self.line("</div>");
    }
    /// Adds what a diagnosis was made from, and the document that explains it.
    pub fn made_from(&mut self, made: &[[String; 2]], guide: &str) {
        self.heading("Made from");
        self.table("|", made);
        let read = "of the program explains how to read this page.";
        self.quiet(&format!("{guide} {read}"));
    }
    fn line(&mut self, markup: impl Display) {
        self.0 += &format!("{markup}\n");
    }
    /// The complete file.
    pub fn html(&self) -> String {
        format!("{}</body></html>\n", self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_between_backticks_is_code() {
        let mut page = Page::new("x");
        page.text("run `a <b>` now");
        assert!(
            page.html()
                .contains("<p>run <code>a &lt;b&gt;</code> now</p>")
        );
    }

    #[test]
    fn text_is_escaped() {
        let mut page = Page::new("<x>");
        page.text("<script>alert(1)</script>");
        page.table("a", [["1 & 2".to_owned()]]);
        let html = page.html();
        assert!(
            !html.contains("<script")
                && html.contains("1 &amp; 2")
                && html.contains("<h1>&lt;x&gt;</h1>")
        );
    }
}
