//! `gripcast dataset import`: make a dataset of Parquet shards of somebody else's files.
//!
//! ```text
//! gripcast dataset import --from feeling-of-success calandra_corl2017_*.h5 --out D
//! gripcast dataset import --from feeling-of-success *.h5 --out D \
//!     --split train=0.7,validation=0.15,test=0.15
//! ```
//!
//! `eval` and `train` read what it writes. Objects are not shared between parts. A grasp that cannot
//! be read is left out and told. A stopped import is begun again by the same command.
//!
//! Exit codes: 0 all is imported · 1 could not be done · 2 the command line is wrong · 3 finished, but
//! some grasps could not be read.

use std::fmt::Write as _;
use std::path::PathBuf;

use clap::ValueEnum;

use super::dataset_text::{counted, progress_bar, to_value};
use super::{Context, print, print_json};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_dataset::shard::SplitFractions;
use gripcast_interop::import::{ImportReport, import_feeling_of_success};

/// Arguments.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Whose files they are
    #[arg(long, value_enum)]
    from: Origin,
    /// The files
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// New folder for the dataset
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Parts and their fractions
    #[arg(long, value_name = "PART=FRACTION,…", default_value = "test")]
    split: SplitFractions,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Origin {
    /// Calandra et al., 2017: calandra_corl2017_*.h5
    FeelingOfSuccess,
}

/// Runs the verb.
pub(super) fn run(context: &Context, args: &Args) -> Result<()> {
    let bar = progress_bar(context, "importing");
    let told = |done: usize, all: usize| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
    };
    let report = match args.from {
        Origin::FeelingOfSuccess => {
            import_feeling_of_success(&args.files, &args.out, &args.split, &told)
        }
    };
    bar.finish_and_clear();
    let report = report?;
    if args.json {
        print_json(&to_value(&report)?)?;
    } else {
        print(&text(&report))?;
    }
    if report.left_out.is_empty() {
        return Ok(());
    }
    let what = format!("{} left out", counted(report.left_out.len(), "grasp"));
    Err(Error::new(ErrorKind::Partial, what)
        .at(args.out.display())
        .remedy("import.json has the reasons; fetch damaged files again"))
}

fn text(report: &ImportReport) -> String {
    let mut text = String::new();
    for (name, part) in &report.splits {
        let _ = writeln!(
            text,
            "{name:<12} {} held, {} lost, {}",
            part.stable,
            part.slip,
            counted(part.objects, "object")
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
    fn train_and_eval_open_what_was_imported() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("calandra_corl2017_000.h5");
        fs::write(&file, DEEPDISH).unwrap();
        let import = |out: &Path, split: &str| {
            let split = split.parse().unwrap();
            import_feeling_of_success(std::slice::from_ref(&file), out, &split, &|_, _| {})
        };
        let out = folder.path().join("all");
        let report = import(&out, "test").unwrap();
        assert_eq!(text(&report), "test         4 held, 8 lost, 2 objects\n");
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
        let out = folder.path().join("divided");
        import(&out, "train=0.5,validation=0.5").unwrap();
        let train = Samples::open(&out, "train").unwrap();
        train
            .check_apart(&Samples::open(&out, "validation").unwrap())
            .unwrap();
    }
}
