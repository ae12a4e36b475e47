//! The page of a comparison: one file of XHTML that needs no other.

use super::tables::short;
use super::{Comparison, Row};
use crate::results::chart::escaped;
use crate::results::page::{STYLE, grouped};
use crate::results::plots::Figure;

pub(crate) fn page(comparison: &Comparison, rows: &[Row<'_>], figures: &[Figure]) -> String {
    let title = escaped(&comparison.title);
    let incomplete = rows.iter().filter(|row| row.state() != "complete").count();
    let state = match incomplete {
        0 => format!("<span class=\"state\">all {} runs complete</span>", rows.len()),
        n => format!("<span class=\"state failed\">{n} of {} runs not complete</span>", rows.len()),
    };
    let mut html = format!(
        "<!DOCTYPE html>\n<html lang=\"en\" xmlns=\"http://www.w3.org/1999/xhtml\">\n<head>\n<meta charset=\"utf-8\"/>\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\n<title>{title}</title>\n\
         <style>{STYLE}</style>\n</head>\n<body>\n<main>\n{state}\n<h1>{title}</h1>\n"
    );
    for paragraph in comparison.question.split("\n\n").filter(|p| !p.trim().is_empty()) {
        html += &format!("<p class=\"about\">{}</p>\n", escaped(paragraph.trim()));
    }
    let mut facts = vec![(grouped(rows.len()), "runs".to_owned())];
    let varying = comparison.choices.iter().filter(|c| c.varies());
    facts.extend(varying.map(|c| (grouped(c.options.len()), c.label.clone())));
    let iterations: usize = rows.iter().filter_map(|row| Some(row.measures.as_ref()?.iterations)).sum();
    facts.push((grouped(iterations), "coupling iterations".into()));
    html += "<div class=\"facts\">\n";
    facts.iter().for_each(|(n, what)| html += &format!("<div><b>{n}</b><span>{}</span></div>\n", escaped(what)));
    html += "</div>\n<div class=\"plots\">\n";
    for figure in figures {
        html += &format!("<figure>{}<figcaption>{}</figcaption></figure>\n", figure.svg, escaped(&figure.caption));
    }
    html += "</div>\n<h2>Runs</h2>\n<div class=\"wide\"><table><thead><tr>";
    let (heads, cells) = short(comparison, rows);
    let class = |c: usize| if heads[c].1 { " class=\"n\"" } else { "" };
    (0..heads.len()).for_each(|c| html += &format!("<th{}>{}</th>", class(c), escaped(&heads[c].0)));
    html += "</tr></thead><tbody>\n";
    for row in &cells {
        html += "<tr>";
        row.iter().enumerate().for_each(|(c, cell)| html += &format!("<td{}>{}</td>", class(c), escaped(cell)));
        html += "</tr>\n";
    }
    html += "</tbody></table></div>\n";
    if incomplete > 0 {
        html += "<h2>Why runs are not complete</h2>\n<div class=\"wide\"><table><tbody>\n";
        for row in rows.iter().filter(|row| row.state() != "complete") {
            let (name, reason) = (escaped(&comparison.name_of(row.entry)), escaped(&row.reason()));
            html += &format!("<tr><th>{}: {name}</th><td>{reason}</td></tr>\n", row.entry.number);
        }
        html += "</tbody></table></div>\n";
    }
    let fixed: Vec<String> =
        comparison.choices.iter().filter(|c| !c.varies()).map(|c| format!("{} {}", c.label, c.options[0])).collect();
    if !fixed.is_empty() {
        html += &format!("<p>In all runs: {}.</p>\n", escaped(&fixed.join(", ")));
    }
    let command = escaped(&comparison.command.join(" "));
    html + "<h2>To repeat this</h2>\n<p><code>"
        + &command
        + "</code></p>\n<p>The model of each run is runs/NUMBER/model.toml: <code>orchestrator run runs/0001</code> makes \
           all its results.</p>\n<p>Files: <a href=\"runs.csv\">runs.csv</a>, <a href=\"attempts.csv\">attempts.csv</a>, \
           <a href=\"comparison.h5\">comparison.h5</a> (with the residuals of every coupling iteration).</p>\n\
           </main>\n</body>\n</html>\n"
}
