//! `gripcast dataset import`: imports a third-party dataset as Parquet shards.
//!
//! ```text
//! gripcast dataset import --from feeling-of-success calandra_corl2017_*.h5 --out D
//! gripcast dataset import --from feeling-of-success *.h5 --out D \
//!     --split train=0.7,validation=0.15,test=0.15
//! ```
//!
//! The result is a dataset for `train` and `eval`; no object is in two splits. Unreadable grasps
//! are reported and left out. An interrupted import starts again from the beginning.
//!
//! Exit codes: 0 all imported · 1 failed · 2 usage · 3 done, but some grasps were unreadable · 130
//! interrupted.

use std::fmt::Write as _;
use std::path::PathBuf;

use clap::ValueEnum;

use super::dataset_text::counted;
use super::working::interruptible;
use super::{Context, print_report};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_dataset::shard::SplitFractions;
use gripcast_interop::import::{ImportReport, import_feeling_of_success};

/// Arguments.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Files to import
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Source dataset
    #[arg(long, value_enum, value_name = "DATASET")]
    from: Origin,
    /// Output directory of the dataset; must not exist
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Splits and their fractions
    #[arg(long, value_name = "SPLIT=FRACTION,…", default_value = "test")]
    split: SplitFractions,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Origin {
    /// Calandra et al., 2017: calandra_corl2017_*.h5
    FeelingOfSuccess,
}

/// Runs the command.
pub(super) fn run(context: &Context, args: Args) -> Result<()> {
    let (out, json) = (args.out.clone(), args.json);
    let report = interruptible(context, "importing", move |progress| {
        let on_progress = |done: usize, all: usize| progress.count(done, all);
        match args.from {
            Origin::FeelingOfSuccess => {
                import_feeling_of_success(&args.files, &args.out, &args.split, &on_progress)
            }
        }
    })??;
    print_report(json, &report, text)?;
    if report.left_out.is_empty() {
        return Ok(());
    }
    let what = format!("{} left out", counted(report.left_out.len(), "grasp"));
    Err(Error::new(ErrorKind::Partial, what)
        .at(out.display())
        .remedy("import.json has the reasons; download damaged files again"))
}

fn text(report: &ImportReport) -> String {
    let mut text = String::new();
    for (name, split) in &report.splits {
        let _ = writeln!(
            text,
            "{name:<12} {} stable, {} slip, {}",
            split.stable,
            split.slip,
            counted(split.objects, "object")
        );
    }
    for one in &report.left_out {
        let _ = writeln!(text, "left out     {}: {}", one.id, one.reason);
    }
    text
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use super::*;
    use gripcast_imaging::CropProfile;
    use gripcast_train::Samples;

    const DEEPDISH: &[u8] = include_bytes!("../../tests/data/import/deepdish.h5");

    #[test]
    fn imported_dataset_is_readable_by_train_and_eval() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("calandra_corl2017_000.h5");
        fs::write(&file, DEEPDISH).unwrap();
        let import = |out: &Path, split: &str| {
            let split = split.parse().unwrap();
            import_feeling_of_success(std::slice::from_ref(&file), out, &split, &|_, _| {})
        };
        let out = folder.path().join("all");
        let report = import(&out, "test").unwrap();
        assert_eq!(text(&report), "test         4 stable, 8 slip, 2 objects\n");
        let samples = Samples::open(&out, "test").unwrap();
        assert_eq!(samples.by_label(), [8, 4]);
        let crop = CropProfile::by_name(samples.crop_profile()).unwrap();
        assert_eq!(crop, CropProfile::GELSIGHT_2017_FULL);
        assert!(
            samples
                .facts()
                .iter()
                .all(|facts| facts.stop_force_n.is_none())
        );
        let out = folder.path().join("split");
        import(&out, "train=0.5,validation=0.5").unwrap();
        let train = Samples::open(&out, "train").unwrap();
        train
            .check_disjoint(&Samples::open(&out, "validation").unwrap())
            .unwrap();
    }
}
