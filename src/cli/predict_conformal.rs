//! `gripcast predict conformal`: writes a model with the conformal scores of labelled grasps.

use std::path::PathBuf;
use std::slice;

use super::working::interruptible;
use super::{Context, print_report};
use gripcast_base::error::Result;
use gripcast_base::files::save;
use gripcast_nn::predict::conformal::{ConformalScores, METADATA};
use gripcast_nn::predict::{Model, model_bytes};
use gripcast_train::{Samples, conformal_scores, dataset_sha256, trained_objects};
use serde_json::json;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct ConformalArgs {
    /// ONNX file, or gripcast-vt (built-in classifier)
    #[arg(value_name = "MODEL")]
    model: String,
    /// Folder of a dataset with labelled grasps that the model was not trained on
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// Split of the dataset
    #[arg(long, value_name = "NAME", default_value = "validation")]
    split: String,
    /// File to write
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub(super) fn run(context: &Context, args: ConformalArgs) -> Result<()> {
    let (is_json, out) = (args.json, args.out.clone());
    let (scores, shared) = interruptible(context, "predicting", move |progress| {
        let bytes = model_bytes(&args.model)?;
        let model = Model::from_bytes(&bytes).map_err(|e| e.at(&args.model))?;
        let samples = Samples::open(&args.data, &args.split)?;
        let trained = trained_objects(model.contract());
        let shared = samples.count_named(&trained);
        let count = samples.facts().len();
        let sha256 = dataset_sha256(slice::from_ref(&args.data))?;
        let dataset = sha256.get(..12).unwrap_or_default();
        let source = format!("{} of dataset {dataset}", args.split);
        let scores = conformal_scores(&model, &samples, &source, &|done| {
            progress.count(done, count);
        })?;
        let mut contract = model.contract().clone();
        contract
            .other
            .insert(METADATA.to_owned(), scores.to_metadata());
        save(&args.out, &contract.stamp(&bytes)?)?;
        Ok::<(ConformalScores, usize), gripcast_base::error::Error>((scores, shared))
    })??;
    if shared > 0 {
        context.warn([format!(
            "the model was trained on {shared} objects of the same name; if they are the same \
             objects, its sets are wrong more often than the error rate"
        )]);
    }
    let [slip, stable] = scores.grasps();
    let report = json!({
        "model": out,
        "source": scores.source(),
        "slip": slip,
        "stable": stable,
    });
    print_report(is_json, &report, |_| {
        format!(
            "wrote {} with the scores of {stable} stable grasps and {slip} slips",
            out.display()
        )
    })
}
