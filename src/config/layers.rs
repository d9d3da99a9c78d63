//! The layers of the configuration: defaults < TOML file < `GRIPCAST__SECTION__KEY` < flags, with
//! the origin of every value.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use toml::de::{DeTable, DeValue};
use toml::{Table, Value};

use super::values::checked;
use super::{Config, FilesConfig};
use gripcast_base::error::{Error, Result, nearest_name};

/// Prefix of environment variables.
const ENV_PREFIX: &str = "GRIPCAST__";

/// Returns whether a key is ignored in the `gripcast.toml` of the current folder.
///
/// Such a file may come with third-party data. It may set what is collected and how, but not
/// network access and credentials, nor where files outside the dataset are written, removed or read
/// through links. No key names a command to execute; such a key would be protected as well.
fn is_protected(key: &str) -> bool {
    key.starts_with("daemon.") || key.starts_with("files.") || key == "black_box.directory"
}
/// Origin of a value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Origin {
    /// Built-in default.
    Default,
    /// A configuration file and the line, from 1.
    File(PathBuf, usize),
    /// An environment variable.
    Environment(String),
    /// A command-line flag.
    Flag(String),
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Default => f.write_str("default"),
            Self::File(path, line) => write!(f, "{}:{line}", path.display()),
            Self::Environment(name) => f.write_str(name),
            Self::Flag(name) => f.write_str(name),
        }
    }
}

/// A configuration file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ConfigFile {
    /// A file named by the user, or the user's own file.
    Chosen(PathBuf),
    /// `gripcast.toml` in the current folder, not named by the user.
    Found(PathBuf),
}

impl ConfigFile {
    /// Returns its path.
    #[must_use]
    pub fn path(&self) -> &Path {
        match self {
            Self::Chosen(path) | Self::Found(path) => path,
        }
    }
}

/// An ignored value: a protected key in the `gripcast.toml` of the current folder.
#[derive(Clone, Debug, PartialEq)]
pub struct Ignored {
    /// The value.
    pub value: Value,
    /// The file that sets it.
    pub file: PathBuf,
}

impl Ignored {
    /// Explains why `key` was ignored and how to set it.
    #[must_use]
    pub fn warning(&self, key: &str) -> String {
        let (value, file) = (&self.value, self.file.display());
        let flag = match key {
            "daemon.listen" => ", --listen",
            "daemon.socket" => ", --socket",
            "daemon.token_file" => ", --token-file",
            _ => "",
        };
        let variable = key.to_uppercase().replace('.', "__");
        format!(
            "warning: {file}: `{key} = {value}` is ignored. A file found in the current folder \
             cannot open the network or choose where files go. To set it on purpose, use \
             --config ./{file}{flag} or {ENV_PREFIX}{variable}"
        )
    }
}

/// The configuration and the origin of every value, by dotted key.
#[derive(Clone, Debug)]
pub struct Layered {
    /// Merged values.
    pub config: Config,
    /// Dotted key → value and origin, sorted.
    pub values: BTreeMap<String, (Value, Origin)>,
    /// Dotted key → ignored value that no other layer sets.
    pub ignored: BTreeMap<String, Ignored>,
}

/// A given flag: name, dotted key and value.
pub type FlagValue = (&'static str, &'static str, String);

/// Merges all layers.
///
/// # Errors
/// `Config` for an invalid file, an unknown key (with the nearest one) or a value of the wrong
/// type; each names its origin.
pub fn load(
    file: Option<&ConfigFile>,
    environment: impl IntoIterator<Item = (String, String)>,
    flags: &[FlagValue],
) -> Result<Layered> {
    let text = file.map(|file| {
        let path = file.path();
        std::fs::read_to_string(path)
            .map_err(|e| Error::io("cannot read the configuration file", e).at(path.display()))
    });
    let text = text.transpose()?;
    merge(file.zip(text.as_deref()), environment, flags)
}

/// Merges all layers like [`load`], with the text of the file.
///
/// # Errors
/// As [`load`].
pub fn merge(
    file: Option<(&ConfigFile, &str)>,
    environment: impl IntoIterator<Item = (String, String)>,
    flags: &[FlagValue],
) -> Result<Layered> {
    let defaults = Table::try_from(Config::default())
        .map_err(|e| Error::internal("the default configuration is not TOML").because(e))?;
    let mut values = BTreeMap::new();
    flatten("", &defaults, &mut |key, value| {
        values.insert(key, (value.clone(), Origin::Default));
    });

    let mut ignored = BTreeMap::new();
    if let Some((file, text)) = file {
        let path = file.path();
        let table: Table = text.parse().map_err(|e| {
            Error::config("the configuration file is not valid TOML")
                .because(e)
                .at(path.display())
        })?;
        let lines = lines(text);
        let mut given = Vec::new();
        flatten("", &table, &mut |key, value| {
            given.push((key, value.clone()))
        });
        for (key, value) in given {
            let line = lines.get(&key).copied().unwrap_or(1);
            let origin = Origin::File(path.to_owned(), line);
            if matches!(file, ConfigFile::Found(_)) && is_protected(&key) {
                // It must be a key all the same.
                slot(&mut values, &key, &origin)?;
                let file = path.to_owned();
                ignored.insert(key, Ignored { value, file });
            } else {
                set(&mut values, &key, value, origin)?;
            }
        }
    }

    let mut environment: Vec<_> = environment
        .into_iter()
        .filter(|(name, _)| name.starts_with(ENV_PREFIX))
        .collect();
    environment.sort();
    for (name, text) in environment {
        let key = name[ENV_PREFIX.len()..].to_lowercase().replace("__", ".");
        set_text(&mut values, &key, &text, Origin::Environment(name))?;
    }
    for (flag, key, text) in flags {
        set_text(&mut values, key, text, Origin::Flag((*flag).to_owned()))?;
    }

    let config = assemble(&values)?;
    ignored.retain(|key, _| values[key].1 == Origin::Default);
    Ok(Layered {
        config,
        values,
        ignored,
    })
}

/// Returns the default configuration file: `./gripcast.toml`, else
/// `$XDG_CONFIG_HOME/gripcast/config.toml`.
#[must_use]
pub fn default_file() -> Option<ConfigFile> {
    let local = PathBuf::from("gripcast.toml");
    if local.is_file() {
        return Some(ConfigFile::Found(local));
    }
    user_file().map(ConfigFile::Chosen)
}

/// Returns `$XDG_CONFIG_HOME/gripcast/config.toml`, if it exists.
fn user_file() -> Option<PathBuf> {
    let home = std::env::var_os("XDG_CONFIG_HOME")
        .map(PathBuf::from)
        .or_else(|| std::env::var_os("HOME").map(|home| Path::new(&home).join(".config")))?;
    let own = home.join("gripcast/config.toml");
    own.is_file().then_some(own)
}

/// Returns `files.linked_folders` of the environment, else of the user's own file, before a command
/// reads its configuration. An invalid file is reported by the commands that read it.
#[must_use]
pub fn linked_folders() -> Vec<PathBuf> {
    let linked_folders = std::env::var(format!("{ENV_PREFIX}FILES__LINKED_FOLDERS")).ok();
    let linked_folders = linked_folders.or_else(|| {
        let text = std::fs::read_to_string(user_file()?).ok()?;
        let table: Table = text.parse().ok()?;
        let folders = table.get("files")?.get("linked_folders")?;
        folders.as_str().map(str::to_owned)
    });
    let linked_folders = linked_folders.unwrap_or_default();
    FilesConfig { linked_folders }.folders()
}

/// Returns the line of every key, from 1.
fn lines(text: &str) -> BTreeMap<String, usize> {
    fn add(prefix: &str, table: &DeTable<'_>, text: &str, lines: &mut BTreeMap<String, usize>) {
        for (name, value) in table {
            let key = match prefix {
                "" => name.get_ref().to_string(),
                _ => format!("{prefix}.{}", name.get_ref()),
            };
            if let DeValue::Table(inner) = value.get_ref() {
                add(&key, inner, text, lines);
                continue;
            }
            let before = text.get(..name.span().start).unwrap_or_default();
            lines.insert(key, before.matches('\n').count() + 1);
        }
    }
    let mut lines = BTreeMap::new();
    if let Ok(table) = DeTable::parse(text) {
        add("", table.get_ref(), text, &mut lines);
    }
    lines
}

fn flatten(prefix: &str, table: &Table, found: &mut impl FnMut(String, &Value)) {
    for (key, value) in table {
        let key = if prefix.is_empty() {
            key.clone()
        } else {
            format!("{prefix}.{key}")
        };
        match value {
            Value::Table(inner) => flatten(&key, inner, found),
            value => found(key, value),
        }
    }
}

fn slot<'a>(
    values: &'a mut BTreeMap<String, (Value, Origin)>,
    key: &str,
    origin: &Origin,
) -> Result<&'a mut (Value, Origin)> {
    if !values.contains_key(key) {
        let mut error = Error::config(format!("unknown key `{key}`")).at(origin);
        if let Some(near) = nearest_name(key, values.keys().map(String::as_str)) {
            error = error.remedy(format!("did you mean `{near}`?"));
        }
        return Err(error.remedy("`gripcast config show` lists all keys"));
    }
    values
        .get_mut(key)
        .ok_or_else(|| Error::internal(format!("key `{key}` vanished")))
}

fn set(
    values: &mut BTreeMap<String, (Value, Origin)>,
    key: &str,
    value: Value,
    origin: Origin,
) -> Result<()> {
    let slot = slot(values, key, &origin)?;
    let value = match (&slot.0, value) {
        (Value::Float(_), Value::Integer(n)) => Value::Float(n as f64),
        (_, value) => value,
    };
    if slot.0.type_str() != value.type_str() {
        let (expected, found) = (slot.0.type_str(), value.type_str());
        return Err(
            Error::config(format!("`{key}` must be of type {expected}, found {found}")).at(origin),
        );
    }
    *slot = (
        checked(key, value).map_err(|e| refused(key, &e, &origin))?,
        origin,
    );
    Ok(())
}

fn refused(key: &str, error: &Error, origin: &Origin) -> Error {
    Error::config(format!("`{key}`: {}", error.what())).at(origin)
}

fn set_text(
    values: &mut BTreeMap<String, (Value, Origin)>,
    key: &str,
    text: &str,
    origin: Origin,
) -> Result<()> {
    let slot = slot(values, key, &origin)?;
    let expected = slot.0.type_str();
    let value = match &slot.0 {
        Value::Integer(_) => text.parse().ok().map(Value::Integer),
        Value::Float(_) => text.parse().ok().map(Value::Float),
        Value::Boolean(_) => text.parse().ok().map(Value::Boolean),
        _ => Some(Value::String(text.to_owned())),
    };
    let Some(value) = value else {
        return Err(Error::config(format!(
            "`{key}` must be of type {expected}, found `{text}`"
        ))
        .at(origin));
    };
    *slot = (
        checked(key, value).map_err(|e| refused(key, &e, &origin))?,
        origin,
    );
    Ok(())
}

/// Keys are a section and a name.
fn assemble(values: &BTreeMap<String, (Value, Origin)>) -> Result<Config> {
    let mut root = Table::new();
    for (key, (value, _)) in values {
        let (section, name) = key.split_once('.').unwrap_or(("", key));
        let section = root.entry(section).or_insert(Value::Table(Table::new()));
        if let Value::Table(section) = section {
            section.insert(name.to_owned(), value.clone());
        }
    }
    root.try_into()
        .map_err(|e| Error::config("invalid configuration").because(e))
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::error::ErrorKind;

    fn none() -> Vec<(String, String)> {
        Vec::new()
    }

    #[test]
    fn later_layers_override_and_keep_origin() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("c.toml");
        std::fs::write(
            &file,
            "[collect]\nrig = \"a\"\nscene = \"lab\"\n[guards]\nmax_skew_ms = 25\n",
        )
        .unwrap();
        let env = [("GRIPCAST__COLLECT__RIG".to_owned(), "b".to_owned())];
        let flags = [("--rig", "collect.rig", "c".to_owned())];
        let layered = load(Some(&ConfigFile::Chosen(file.clone())), env, &flags).unwrap();
        assert_eq!(layered.config.collect.rig, "c");
        assert_eq!(layered.config.collect.scene, "lab");
        assert!((layered.config.guards.max_skew_ms - 25.0).abs() < 1e-12);
        assert_eq!(
            layered.values["collect.rig"].1,
            Origin::Flag("--rig".into())
        );
        assert_eq!(layered.values["collect.scene"].1, Origin::File(file, 3));
        assert_eq!(layered.values["collect.sound"].1, Origin::Default);
    }

    #[test]
    fn file_in_current_folder_cannot_set_protected_keys() {
        let path = PathBuf::from("gripcast.toml");
        let text = "[daemon]\nlisten = \"0.0.0.0:7471\"\nsocket = \"/tmp/s\"\ntoken_file = \"t\"\n\
                    [black_box]\ndirectory = \"/home/ada\"\nenabled = true\n[collect]\nscene = \"lab\"\n";
        let found = ConfigFile::Found(path.clone());
        let env = [("GRIPCAST__DAEMON__SOCKET".to_owned(), "none".to_owned())];
        let layered = merge(Some((&found, text)), env, &[]).unwrap();
        let config = &layered.config;
        assert_eq!(
            config.daemon.listen,
            crate::config::DaemonConfig::default().listen
        );
        assert_eq!(config.daemon.socket, "none");
        assert_eq!(config.daemon.token_file, "");
        assert_eq!(config.black_box.directory, "");
        assert!(config.black_box.enabled && config.collect.scene == "lab");
        // The socket is set by another layer, so it is not listed.
        let keys: Vec<&str> = layered.ignored.keys().map(String::as_str).collect();
        assert_eq!(
            keys,
            ["black_box.directory", "daemon.listen", "daemon.token_file"]
        );
        let warning = layered.ignored["daemon.listen"].warning("daemon.listen");
        for part in [
            "gripcast.toml: `daemon.listen = \"0.0.0.0:7471\"`",
            "--config ./gripcast.toml",
            "--listen",
            "GRIPCAST__DAEMON__LISTEN",
        ] {
            assert!(warning.contains(part), "{warning}");
        }

        let chosen = ConfigFile::Chosen(path);
        let layered = merge(Some((&chosen, text)), none(), &[]).unwrap();
        assert_eq!(layered.config.daemon.listen, "0.0.0.0:7471");
        assert_eq!(layered.config.black_box.directory, "/home/ada");
        assert!(layered.ignored.is_empty());

        let unknown = "[daemon]\nlisen = \"0.0.0.0:7471\"\n";
        let error = merge(Some((&found, unknown)), none(), &[]).unwrap_err();
        assert!(error.to_string().contains("daemon.listen"), "{error}");
    }

    #[test]
    fn unknown_key_names_nearest_and_origin() {
        let env = [("GRIPCAST__COLLECT__OPERATR".to_owned(), "x".to_owned())];
        let error = load(None, env, &[]).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Config);
        let text = error.to_string();
        assert!(text.contains("collect.operator") && text.contains("GRIPCAST__COLLECT__OPERATR"));
    }

    #[test]
    fn wrong_types_are_refused() {
        let env = [(
            "GRIPCAST__GUARDS__MAX_SKEW_MS".to_owned(),
            "wide".to_owned(),
        )];
        let text = load(None, env, &[]).unwrap_err().to_string();
        assert!(text.contains("max_skew_ms") && text.contains("float") && text.contains("wide"));
    }

    /// Every numeric key, from a file, a variable and a flag.
    #[test]
    fn numbers_are_finite_and_in_range_at_every_source() {
        let defaults = load(None, none(), &[]).unwrap().values;
        let is_number = |value: &Value| matches!(value, Value::Float(_) | Value::Integer(_));
        let keys: Vec<&String> = defaults
            .iter()
            .filter(|(_, (value, _))| is_number(value))
            .map(|(key, _)| key)
            .collect();
        assert!(keys.len() >= 8, "{keys:?}");
        let file = ConfigFile::Chosen(PathBuf::from("c.toml"));
        for key in keys {
            let (section, name) = key.split_once('.').unwrap();
            let is_float = matches!(defaults[key].0, Value::Float(_));
            for bad in ["nan", "inf", "-inf", "1e400", "-1", "-0.5"] {
                let variable = format!("{ENV_PREFIX}{}", key.to_uppercase().replace('.', "__"));
                let environment = [(variable.clone(), bad.to_owned())];
                let error = load(None, environment, &[]).unwrap_err();
                let text = error.to_string();
                assert_eq!(error.kind().exit_code(), 2, "{text}");
                assert!(text.contains(key) && text.contains(&variable), "{text}");
                let flags = [("--some-flag", "guards.max_skew_ms", bad.to_owned())];
                let text = load(None, none(), &flags).unwrap_err().to_string();
                assert!(text.contains("--some-flag"), "{text}");
                // TOML has no 1e400, and an integer key refuses a float by its type.
                if bad == "1e400" || (!is_float && bad != "-1") {
                    continue;
                }
                let text = format!("# comment\n[{section}]\n{name} = {bad}\n");
                let text = merge(Some((&file, &text)), none(), &[])
                    .unwrap_err()
                    .to_string();
                assert!(text.contains(key) && text.contains("c.toml:3"), "{text}");
                assert!(
                    text.contains("expected") && text.contains("found"),
                    "{text}"
                );
            }
        }
        let text = "guards.max_skew_ms = 1e400\n";
        assert!(merge(Some((&file, text)), none(), &[]).is_err());
    }

    #[test]
    fn names_are_checked_with_their_origin() {
        let file = ConfigFile::Chosen(PathBuf::from("c.toml"));
        for (key, name) in [
            ("object", ""),
            ("object", "  "),
            ("object", "a/b"),
            ("scene", "a\\nb"),
        ] {
            let text = format!("[collect]\n{key} = \"{name}\"\n");
            let error = merge(Some((&file, &text)), none(), &[])
                .unwrap_err()
                .to_string();
            assert!(error.contains("c.toml:2") && error.contains(key), "{error}");
        }
        let env = [("GRIPCAST__COLLECT__OBJECT".to_owned(), String::new())];
        let error = load(None, env, &[]).unwrap_err().to_string();
        assert!(error.contains("GRIPCAST__COLLECT__OBJECT"), "{error}");
        let text = "collect.object = \"Gro\u{308}\u{df}e\"\n";
        let layered = merge(Some((&file, text)), none(), &[]).unwrap();
        assert_eq!(layered.config.collect.object, "Gr\u{f6}\u{df}e");
    }

    #[test]
    fn defaults_assemble_to_default_config() {
        assert_eq!(load(None, none(), &[]).unwrap().config, Config::default());
    }

    #[test]
    fn invalid_toml_is_explained() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("c.toml");
        std::fs::write(&file, "[collect\n").unwrap();
        let error = load(Some(&ConfigFile::Chosen(file)), none(), &[]).unwrap_err();
        assert!(error.to_string().contains("c.toml"), "{error}");
        assert_eq!(error.kind().exit_code(), 2);
    }
}
