//! `gripcast dataset import`: imports a third-party dataset as Parquet shards, or pairs of videos as a
//! dataset of grasps.
//!
//! ```text
//! gripcast dataset import --from feeling-of-success calandra_corl2017_*.h5 --out D
//! gripcast dataset import --from feeling-of-success *.h5 --out D \
//!     --split train=0.7,validation=0.15,test=0.15
//! gripcast dataset import --from video clips.csv --out D
//! ```
//!
//! Shards are a dataset for `train` and `eval`; no object is in two splits. An interrupted import of
//! shards starts again from the beginning, one of videos continues. Unreadable grasps are reported
//! and left out.
//!
//! Exit codes: 0 all imported · 1 failed · 2 usage · 3 done, but some grasps were unreadable · 130
//! interrupted.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use clap::ValueEnum;

use super::dataset_text::counted;
use super::working::interruptible;
use super::{Context, print_report};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::ObjectName;
use gripcast_dataset::shard::SplitFractions;
use gripcast_imaging::CropProfile;
use gripcast_interop::import::video::{
    OnsetSettings, VideoImport, VideoReport, clips_of, import_videos,
};
use gripcast_interop::import::{ImportReport, LeftOut, import_feeling_of_success};

/// Arguments.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Files to import; for `video` one table of clips (JSON, CSV) or a folder with a folder a clip
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Source dataset
    #[arg(long, value_enum, value_name = "DATASET")]
    from: Origin,
    /// Output directory of the dataset; must not exist
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Splits of shards and their fractions [default: test]
    #[arg(long, value_name = "SPLIT=FRACTION,…")]
    split: Option<SplitFractions>,
    #[command(flatten)]
    video: VideoFlags,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Origin {
    /// Calandra et al., 2017: calandra_corl2017_*.h5
    FeelingOfSuccess,
    /// Pairs of videos of two tactile sensors; needs ffmpeg
    Video,
}

/// Options of `--from video`.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Videos")]
struct VideoFlags {
    /// Video of the left sensor; `{column}` is a value of the table [default: column `left`]
    #[arg(long, value_name = "PATTERN", requires = "right")]
    left: Option<String>,
    /// Video of the right sensor [default: column `right`]
    #[arg(long, value_name = "PATTERN", requires = "left")]
    right: Option<String>,
    /// Object of clips without one in the table
    #[arg(long, value_name = "NAME")]
    object: Option<ObjectName>,
    /// Frame of the open gripper, from 0 [default: column `initial_frame`, else found]
    #[arg(long, value_name = "N")]
    initial_frame: Option<usize>,
    /// Frame of the closed gripper, from 0 [default: column `grasp_frame`, else found]
    #[arg(long, value_name = "N")]
    grasp_frame: Option<usize>,
    /// Take the last frame for the initial one in clips that begin in contact
    #[arg(long)]
    initial_at_end: bool,
    /// Frames at the beginning that are not used, such as old ones of the camera [default: 5]
    #[arg(long, value_name = "N")]
    skip: Option<usize>,
    /// Frames in which both fingers must come into contact [default: 60]
    #[arg(long, value_name = "N")]
    search: Option<usize>,
    /// Frames from the contact of both fingers to the grasp frame [default: 3]
    #[arg(long, value_name = "N")]
    settle: Option<usize>,
    /// Crop profile of the frames [default: full-v1]
    #[arg(long, value_name = "PROFILE")]
    crop: Option<String>,
    /// Licence of the videos, stored in the dataset [default: unknown]
    #[arg(long, value_name = "TEXT")]
    licence: Option<String>,
}

impl VideoFlags {
    fn is_used(&self) -> bool {
        let numbers = [
            self.initial_frame,
            self.grasp_frame,
            self.skip,
            self.search,
            self.settle,
        ];
        self.left.is_some()
            || self.object.is_some()
            || self.crop.is_some()
            || self.licence.is_some()
            || self.initial_at_end
            || numbers.iter().any(Option::is_some)
    }

    fn settings(&self, out: &Path) -> Result<VideoImport> {
        let crop = self.crop.as_deref().map(CropProfile::by_name).transpose();
        let usual = OnsetSettings::default();
        let name = out.file_name().unwrap_or_default().to_string_lossy();
        Ok(VideoImport {
            name: name.into_owned(),
            licence: self.licence.clone().unwrap_or_else(|| "unknown".to_owned()),
            label_definition: "as in the list of clips".to_owned(),
            crop: crop
                .map_err(|e| e.at("--crop"))?
                .unwrap_or(CropProfile::FULL),
            onset: OnsetSettings {
                skip: self.skip.unwrap_or(usual.skip),
                search: self.search.unwrap_or(usual.search),
                ..usual
            },
            settle: self.settle.unwrap_or(3),
            initial_frame: self.initial_frame,
            grasp_frame: self.grasp_frame,
            initial_at_end: self.initial_at_end,
        })
    }
}

/// Runs the command.
pub(super) fn run(context: &Context, args: Args) -> Result<()> {
    match args.from {
        Origin::FeelingOfSuccess => import_shards(context, args),
        Origin::Video => import_clips(context, args),
    }
}

fn import_shards(context: &Context, args: Args) -> Result<()> {
    if args.video.is_used() {
        return Err(Error::usage("the options of videos need `--from video`"));
    }
    let (out, json) = (args.out.clone(), args.json);
    let report = interruptible(context, "importing", move |progress| {
        let on_progress = |done: usize, all: usize| progress.count(done, all);
        let split = match args.split {
            Some(split) => split,
            None => "test".parse()?,
        };
        import_feeling_of_success(&args.files, &args.out, &split, &on_progress)
    })??;
    print_report(json, &report, text)?;
    told(
        &report.left_out,
        &out,
        "grasp",
        "import.json has the reasons; download damaged files again",
    )
}

fn import_clips(context: &Context, args: Args) -> Result<()> {
    let [source] = &args.files[..] else {
        return Err(Error::usage(
            "`--from video` takes one table of clips or one folder",
        ));
    };
    if args.split.is_some() {
        return Err(Error::usage("`--split` is for shards")
            .remedy("split the dataset afterwards: `gripcast dataset split`"));
    }
    let flags = &args.video;
    let settings = flags.settings(&args.out)?;
    let patterns = [flags.left.as_deref(), flags.right.as_deref()];
    let (clips, left_out) = clips_of(source, patterns, flags.object.as_ref())?;
    let out = args.out.clone();
    let report = interruptible(context, "importing", move |progress| {
        let on_progress = |done: usize, all: usize| progress.count(done, all);
        import_videos(&clips, left_out, &out, &settings, &on_progress)
    })??;
    print_report(args.json, &report, clips_text)?;
    told(
        &report.left_out,
        &args.out,
        "clip",
        "give the frames of these clips, or leave their rows out",
    )
}

/// Ends with the exit code of a partial result if anything was left out.
fn told(left_out: &[LeftOut], out: &Path, noun: &str, remedy: &str) -> Result<()> {
    if left_out.is_empty() {
        return Ok(());
    }
    let what = format!("{} left out", counted(left_out.len(), noun));
    Err(Error::new(ErrorKind::Partial, what)
        .at(out.display())
        .remedy(remedy))
}

fn clips_text(report: &VideoReport) -> String {
    let [stable, slip, unlabelled] = report.outcomes;
    let mut text = format!(
        "{} of {}: {stable} stable, {slip} slip, {unlabelled} unlabelled, {}\n",
        report.imported.len(),
        counted(report.clips, "clip"),
        counted(report.objects, "object")
    );
    if report.already_there > 0 {
        let _ = writeln!(text, "already there {}", report.already_there);
    }
    for one in &report.left_out {
        let _ = writeln!(text, "left out      {}: {}", one.id, one.reason);
    }
    text
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
