//! Confident mistakes with what the model saw.

use std::fmt::Write as _;

use crate::evaluate::{ModelEvaluation, sample_pictures};
use crate::samples::Samples;
use gripcast_base::error::Result;
use gripcast_report::picture::{data_uri, picture};
use gripcast_report::{Esc, fixed, put};

pub(super) fn mistakes(model: &ModelEvaluation, samples: &Samples, out: &mut String) -> Result<()> {
    out.push_str(
        "<p>One of each object at most. The small pictures are the tactile changes, grasp minus \
         initial, around grey: left above right.</p>\n",
    );
    for (label, title) in [
        (true, "Held, but predicted lost"),
        (false, "Lost, but predicted stable"),
    ] {
        put!(out, "<h3>{title}</h3>\n");
        let of_label: Vec<_> = model
            .mistakes
            .iter()
            .filter(|m| m.stable == label)
            .collect();
        if of_label.is_empty() {
            out.push_str("<p class=\"nothing\">None.</p>\n");
            continue;
        }
        out.push_str("<ul class=\"grasps\">\n");
        for mistake in of_label {
            let [left, right, rgb] = sample_pictures(samples, mistake.sample)?;
            put!(
                out,
                "<li class=\"{}\"><div class=\"views\">",
                if label { "of-held" } else { "of-lost" }
            );
            let views = [(&rgb, "colour"), (&left, "left"), (&right, "right")];
            for (image, name) in views {
                let id = format!("m{}-{name}", mistake.sample);
                let alt = format!("{} {name}", mistake.id);
                picture(out, &data_uri(image)?, &id, &alt);
            }
            put!(
                out,
                "</div><b>{}</b><p>probability of stable {}</p><p>{}</p></li>\n",
                Esc(&mistake.object),
                fixed(mistake.p_stable, 3),
                Esc(&mistake.id)
            );
        }
        out.push_str("</ul>\n");
    }
    Ok(())
}
