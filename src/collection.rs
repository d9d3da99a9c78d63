//! Set-up that `collect` and `daemon` share: rig, model, dataset and pedals of a configuration.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::thread::JoinHandle;
use std::time::Duration;

use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::mpsc;

use super::config::{ADAPT_STRENGTH, CollectConfig, Config, ERROR_RATE_OR_NONE, KEEP_LIFT_S};
use super::daemon::{
    Boards, CommandRequest, DecisionSettings, EndReason, EngineSetup, GelForces, GelScale,
};
use super::model_choice::chosen_model;
use crate::note;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::allow_links_into;
use gripcast_base::number::NumberRange;
use gripcast_capture::calibration::{PedalConfig, RigFile, SourceKind};
use gripcast_capture::camera::{MonotonicClock, RigSources, SupervisionPolicy};
use gripcast_capture::device::SystemRoot;
use gripcast_capture::trigger::{PedalEvent, Script, run_pedal};
use gripcast_dataset::{GraspIndex, NewDataset};
use gripcast_imaging::{Intrinsics, Role};
use gripcast_pose::load_intrinsics;
use gripcast_session::{Command, CommandSource, Labels};
use gripcast_tactile::SensorProfile;
use gripcast_tactile::force::{ForceCalibration, ForceEstimator};
use gripcast_virtual_rig::{VirtualHand, VirtualSource};

/// Capacity of the command queue.
pub(crate) const COMMAND_QUEUE: usize = 64;

/// Debounce times of pedals; a longer one loses steps of the cycle.
const DEBOUNCE_MS: NumberRange = NumberRange::between(0.0, 2000.0).unit("ms");

/// Name of the socket in the folder of runtime files.
const SOCKET: &str = "gripcast.sock";
/// Runtime folder of the systemd unit.
const SERVICE_FOLDER: &str = "/run/gripcast";

/// Label definition of a new dataset.
const LABEL_DEFINITION: &str = "stable: the object stayed in the gripper while it was lifted; \
                                slip: it moved in the gripper or fell";

/// Start options of a collection.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Start {
    /// Seed of the virtual rig.
    pub(crate) seed: u64,
    /// Whether all cameras must be present; absent cameras are waited for otherwise.
    pub(crate) all_present: bool,
    /// Whether notes on stderr are suppressed.
    pub(crate) quiet: bool,
}

/// Prepares the engine for a configuration.
///
/// # Errors
/// `Usage` if rig or dataset is missing, `Device` for an absent camera if all must be present;
/// errors of the rig's files and the model.
pub(crate) fn prepare(
    config: Config,
    rig: RigFile,
    script: Option<Script>,
    start: Start,
) -> Result<EngineSetup> {
    allow_links_into(config.files.folders());
    let settings = config.collect;
    let dataset = chosen_dataset(&settings)?;
    let black_box = config.black_box.settings(&dataset)?;
    let model = chosen_model(&settings.model, &rig, start.quiet)?;
    let root = SystemRoot::default();
    let mut virtual_cameras = VirtualSource::new(start.seed);
    let sources = RigSources::new(&rig, &root, &mut virtual_cameras)?;
    let hand = virtual_cameras.hand();
    if start.all_present {
        sources.check_present()?;
    }
    let mut intrinsics = known_intrinsics(&rig, hand.as_deref())?;
    let (factory, notes) = sources.factory_intrinsics(&rig, &root);
    intrinsics.extend(factory);
    if !start.quiet {
        for note in notes {
            note!("{note}");
        }
    }

    let boards = match (&rig.boards, &hand) {
        (Some(boards), _) => Some(Boards::read(boards)?),
        (None, Some(hand)) => Some(Boards::from_virtual_hand(Arc::clone(hand))?),
        (None, None) => None,
    };
    let is_bound = rig.cameras.contains_key(&Role::External);
    let is_calibrated = intrinsics.contains_key(&Role::External);
    if is_bound && boards.is_some() && !is_calibrated && !start.quiet {
        note!(
            "external: no intrinsics, so grasps get no pose; run `gripcast calibrate intrinsics` and \
             name the file in [cameras.external]"
        );
    }
    let gels = gel_profiles(&rig)?;
    let force_calibrations = force_calibrations(&rig)?;
    Ok(EngineSetup {
        gel_scales: gel_scales(&gels),
        gel_forces: gel_forces(&gels, &force_calibrations)?,
        force_calibrations,
        new_dataset: NewDataset {
            name: dataset_name(&dataset),
            rig: rig.id.clone(),
            licence: settings.licence,
            label_definition: LABEL_DEFINITION.into(),
        },
        rig,
        intrinsics,
        openers: sources.openers,
        supervision: SupervisionPolicy::default(),
        index: GraspIndex::new(&dataset),
        dataset,
        labels: Labels {
            object: settings.object,
            scene: settings.scene,
            operator: settings.operator,
        },
        guards: config.guards,
        model,
        decision: DecisionSettings {
            error_rate: (settings.error_rate > 0.0)
                .then(|| ERROR_RATE_OR_NONE.check(settings.error_rate))
                .transpose()?,
            adapt_strength: settings
                .adapt
                .then(|| ADAPT_STRENGTH.check(settings.adapt_strength))
                .transpose()?,
        },
        script,
        boards,
        hand,
        target_per_object: settings.target_per_object,
        keep_lift: Duration::from_secs_f64(KEEP_LIFT_S.check(settings.keep_lift_s)?),
        black_box,
    })
}

/// Sensor profile of a tactile camera, and whether the rig file names it.
type GelProfile = (SensorProfile, bool);

/// Returns the sensor profiles of the tactile cameras: those that the rig file names, else that of a
/// generic GelSight Mini where the crop is one of its.
fn gel_profiles(rig: &RigFile) -> Result<BTreeMap<Role, GelProfile>> {
    let mut profiles = BTreeMap::new();
    for (role, camera) in &rig.cameras {
        let Some(crop) = camera.crop_profile.as_deref() else {
            continue;
        };
        let Some(name) = &camera.sensor_profile else {
            let mini = SensorProfile::gelsight_mini()?;
            if mini.crop_profile.name() == crop {
                profiles.insert(*role, (mini, false));
            }
            continue;
        };
        let at_camera = |e: Error| e.at(format!("camera {role}"));
        let profile = SensorProfile::named_or_load(name).map_err(at_camera)?;
        if profile.crop_profile.name() != crop {
            let what = format!(
                "the sensor profile `{}` is for the crop {}, the camera has {crop}",
                profile.name,
                profile.crop_profile.name()
            );
            return Err(at_camera(Error::config(what).remedy(
                "set `crop_profile` to that of the profile, or choose another",
            )));
        }
        profiles.insert(*role, (profile, true));
    }
    Ok(profiles)
}

/// Returns scale and gel markers of the tactile cameras.
fn gel_scales(profiles: &BTreeMap<Role, GelProfile>) -> BTreeMap<Role, GelScale> {
    let scale = |(profile, is_named): &GelProfile| GelScale {
        m_per_px: profile.geometry.pixel_m,
        markers: is_named.then(|| profile.markers.clone()),
    };
    profiles
        .iter()
        .map(|(role, gel)| (*role, scale(gel)))
        .collect()
}

/// Reads the force calibrations that the rig file names.
fn force_calibrations(rig: &RigFile) -> Result<BTreeMap<Role, ForceCalibration>> {
    let mut found = BTreeMap::new();
    for (role, camera) in &rig.cameras {
        if let Some(path) = &camera.force_calibration {
            let calibration = ForceCalibration::load(path)?;
            if let Some(serial) = &camera.serial
                && !calibration.serial.is_empty()
                && *serial != calibration.serial
            {
                let what = format!(
                    "the force calibration is of the sensor {}, the camera {role} is {serial}",
                    calibration.serial
                );
                return Err(Error::config(what)
                    .at(path.display())
                    .remedy("run `gripcast calibrate force` for this sensor"));
            }
            found.insert(*role, calibration);
        }
    }
    Ok(found)
}

/// Prepares the force estimators of the tactile cameras. A gel of a size that the model does not know
/// has none; a calibration that does not fit its sensor is an error.
fn gel_forces(
    profiles: &BTreeMap<Role, GelProfile>,
    calibrations: &BTreeMap<Role, ForceCalibration>,
) -> Result<GelForces> {
    let mut forces = GelForces::new();
    for (role, (profile, _)) in profiles {
        let calibration = calibrations.get(role);
        match ForceEstimator::new(profile, calibration) {
            Ok(estimator) => drop(forces.insert(*role, Arc::new(estimator))),
            Err(error) if calibration.is_some() => {
                return Err(error.at(format!("camera {role}")));
            }
            Err(_) => {}
        }
    }
    Ok(forces)
}

/// Loads the intrinsics named by the rig, and those of the external virtual camera.
fn known_intrinsics(
    rig: &RigFile,
    hand: Option<&VirtualHand>,
) -> Result<BTreeMap<Role, Intrinsics>> {
    let mut found = BTreeMap::new();
    for (role, camera) in &rig.cameras {
        let is_virtual = camera.source == SourceKind::Virtual;
        let intrinsics = match (&camera.intrinsics, hand) {
            (Some(path), _) => Some(load_intrinsics(path)?),
            (None, Some(hand)) if is_virtual && *role == Role::External => {
                hand.clip().external_intrinsics(camera.width, camera.height)
            }
            _ => None,
        };
        found.extend(intrinsics.map(|intrinsics| (*role, intrinsics)));
    }
    Ok(found)
}

/// Finds the rig of a configuration.
///
/// # Errors
/// `Usage` if none is named; `Config` for a pedal key without a valid command; as
/// [`RigFile::find`].
pub(crate) fn chosen_rig(settings: &CollectConfig) -> Result<RigFile> {
    if settings.rig.is_empty() {
        return Err(Error::usage("no rig given").remedy(
            "use --rig virtual without cameras; `gripcast rig init` writes a rig file for the \
             connected cameras",
        ));
    }
    let rig = RigFile::find(&settings.rig)?;
    check_pedals(&rig.pedals).map_err(|e| e.at(format!("rig {}", rig.id)))?;
    Ok(rig)
}

/// Checks that every key of a pedal has a command, so that none is ignored during a grasp.
fn check_pedals(pedals: &[PedalConfig]) -> Result<()> {
    for (index, pedal) in pedals.iter().enumerate() {
        DEBOUNCE_MS
            .check(pedal.debounce_ms as f64)
            .map_err(|e| Error::config(format!("pedals[{index}].debounce_ms: {}", e.what())))?;
        for (key, command) in &pedal.keys {
            command.parse::<Command>().map_err(|e| {
                Error::config(format!("pedals[{index}].keys.{key} is not a command: {e}"))
            })?;
        }
    }
    Ok(())
}

/// Returns the dataset folder of a configuration.
///
/// # Errors
/// `Usage` if none is named.
pub(crate) fn chosen_dataset(settings: &CollectConfig) -> Result<PathBuf> {
    if settings.dataset.is_empty() {
        return Err(Error::usage("no dataset given")
            .remedy("use --dataset DIR; the folder is created if absent"));
    }
    Ok(PathBuf::from(&settings.dataset))
}

fn dataset_name(path: &Path) -> String {
    path.file_name().map_or_else(
        || "dataset".into(),
        |name| name.to_string_lossy().into_owned(),
    )
}

/// Returns the default socket of the daemon.
pub(crate) fn usual_socket() -> Option<PathBuf> {
    let service = Path::new(SERVICE_FOLDER);
    let folder = std::env::var_os("XDG_RUNTIME_DIR")
        .map(PathBuf::from)
        .or_else(|| service.is_dir().then(|| service.to_owned()))?;
    Some(folder.join(SOCKET))
}

/// Starts a thread per pedal; the threads end once `ended` is true.
pub(crate) fn start_pedals(
    pedals: Vec<PedalConfig>,
    commands: &mpsc::Sender<CommandRequest>,
    ended: &Arc<AtomicBool>,
) -> Vec<JoinHandle<()>> {
    pedals
        .into_iter()
        .map(|pedal| {
            let (commands, ended) = (commands.clone(), Arc::clone(ended));
            std::thread::spawn(move || listen_to_pedal(&pedal, &commands, &ended))
        })
        .collect()
}

fn listen_to_pedal(
    pedal: &PedalConfig,
    commands: &mpsc::Sender<CommandRequest>,
    ended: &AtomicBool,
) {
    let result = run_pedal(pedal, &MonotonicClock, ended, &mut |event| match event {
        PedalEvent::Trigger(trigger) => {
            if let Ok(command) = trigger.text.parse() {
                // A full queue means commands arrive faster than grasps can be saved.
                let _ = commands.try_send(CommandRequest::new(command, CommandSource::Pedal));
            }
        }
        PedalEvent::Ready { product } => note!("pedal ready: {product}"),
        PedalEvent::Unmapped { key } => note!("pedal key `{key}` has no command in the rig"),
        PedalEvent::Lost { reason } => note!("pedal: {reason}"),
    });
    if let Err(error) = result {
        note!("pedal: {error}");
    }
}

/// Resolves on SIGINT or SIGTERM, with `hangup_ends` also on SIGHUP (closed terminal).
///
/// # Errors
/// `Io`.
pub(crate) fn stop_signals(hangup_ends: bool) -> Result<impl Future<Output = EndReason>> {
    let listen = |kind| signal(kind).map_err(|e| Error::io("cannot listen for signals", e));
    let mut interrupt = listen(SignalKind::interrupt())?;
    let mut terminate = listen(SignalKind::terminate())?;
    let mut hangup = hangup_ends
        .then(|| listen(SignalKind::hangup()))
        .transpose()?;
    Ok(async move {
        let hung_up = async {
            match &mut hangup {
                Some(hangup) => hangup.recv().await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            _ = interrupt.recv() => EndReason::Interrupted,
            _ = terminate.recv() => EndReason::Terminated,
            _ = hung_up => EndReason::Terminated,
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pedal_keys_must_be_commands() {
        let pedal = |command: &str, debounce_ms| PedalConfig {
            vendor: 1,
            product: 2,
            keys: [("a".to_owned(), command.to_owned())].into(),
            debounce_ms,
        };
        assert!(check_pedals(&[pedal("trigger", 80), pedal("object mug", 0)]).is_ok());
        for (command, debounce_ms, expected) in [
            ("trigge", 80, "pedals[1].keys.a"),
            ("object a/b", 80, "object name"),
            ("object ", 80, "pedals[1].keys.a"),
            ("trigger", 3_600_000, "pedals[1].debounce_ms"),
        ] {
            let pedals = [pedal("trigger", 80), pedal(command, debounce_ms)];
            let error = check_pedals(&pedals).unwrap_err();
            assert_eq!(error.kind().exit_code(), 2);
            assert!(error.to_string().contains(expected), "{error}");
        }
    }
}
