//! The films of a virtual rig.

use std::borrow::Cow;
use std::path::Path;
use std::sync::Arc;

use super::film::{Film, FilmFiles, TRACE};
use super::random::mixed;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::Root;

macro_rules! films {
    ($($name:literal),* $(,)?) => {
        [$((
            $name,
            FilmFiles {
                trace: Cow::Borrowed(include_bytes!(concat!(
                    "../../../calib/virtual-rig/", $name, ".trace.bin"
                ))),
                colour: Cow::Borrowed(include_bytes!(concat!(
                    "../../../calib/virtual-rig/", $name, ".colour.jpg"
                ))),
                depth: Cow::Borrowed(include_bytes!(concat!(
                    "../../../calib/virtual-rig/", $name, ".depth.png"
                ))),
                outside: Cow::Borrowed(include_bytes!(concat!(
                    "../../../calib/virtual-rig/", $name, ".outside.jpg"
                ))),
                sheet: Cow::Borrowed(include_bytes!(concat!(
                    "../../../calib/virtual-rig/", $name, ".sheet.toml"
                ))),
            },
        )),*]
    };
}

/// The grasps that a virtual hand goes through.
#[derive(Clone, Debug)]
pub struct FilmLibrary {
    films: Vec<Arc<Film>>,
}

impl FilmLibrary {
    /// The films that come with the program.
    ///
    /// # Errors
    /// None; a test reads them all.
    pub fn built_in() -> Result<Self> {
        let films = films!(
            "mug",
            "bottle-low",
            "ball",
            "ball-aside",
            "bottle",
            "wedge",
            "box",
            "box-end",
        );
        let parsed = films
            .into_iter()
            .map(|(name, files)| Film::parse(name, files, Path::new("")).map(Arc::new));
        Ok(Self {
            films: parsed.collect::<Result<_>>()?,
        })
    }

    /// All films of a folder, in the order of their names; every file of them is read.
    ///
    /// # Errors
    /// `NotFound`, `Io` for a folder or file that cannot be read, or a folder without films;
    /// `Input` for a film that is none.
    pub fn read(folder: &Path) -> Result<Self> {
        let at = |e| Error::io("cannot read the films", e).at(folder.display());
        let mut names = Vec::new();
        for entry in Root::new(folder).top().entries().map_err(at)? {
            names.extend(entry.name().strip_suffix(TRACE).map(str::to_owned));
        }
        names.sort();
        if names.is_empty() {
            return Err(Error::not_found("there are no films")
                .at(folder.display())
                .remedy(
                    "simulate grasps with `gripcast sim grasp … --trace FILE.bin` and make films \
                     of them with `gripcast render film`",
                ));
        }
        let films = names.iter().map(|name| {
            let read = || -> Result<Film> {
                let film = Film::parse(name, FilmFiles::read(folder, name)?, folder)?;
                film.check()?;
                Ok(film)
            };
            read()
                .map(Arc::new)
                .map_err(|e| e.at(folder.join(name).display()))
        });
        Ok(Self {
            films: films.collect::<Result<_>>()?,
        })
    }

    /// Film of the `number`th grasp of a session with `seed`: every round shows each film once,
    /// the first round in the library's order, so that a demonstration is always the same.
    pub fn film(&self, seed: u64, number: u64) -> Arc<Film> {
        let count = self.films.len() as u64;
        let round = number / count;
        let mut order: Vec<usize> = (0..self.films.len()).collect();
        if round > 0 {
            order.sort_by_key(|film| mixed(seed, round, *film as u64));
        }
        self.films[order[(number % count) as usize]].clone()
    }

    /// All films, at least one.
    pub fn films(&self) -> &[Arc<Film>] {
        &self.films
    }
}

#[cfg(test)]
mod tests {
    use gripcast_base::error::ErrorKind;
    use std::fs;

    use super::*;
    use gripcast_sim::grasp::GraspOutcome;

    fn holds(film: &Film) -> bool {
        film.outcome() == GraspOutcome::Success
    }

    #[test]
    fn every_built_in_film_can_be_read_whole() {
        let library = FilmLibrary::built_in().unwrap();
        assert_eq!(library.films().len(), 8);
        for film in library.films() {
            film.check().unwrap();
            let last = film.steps().last().unwrap();
            let first_m = film.truth_at(0).opening_m;
            assert!(
                (first_m - film.start().opening_m).abs() < 1e-3,
                "{}",
                film.name()
            );
            let rest = film.start().t_world_object.translation_m.z;
            let rise = last.t_world_object.translation_m.z - rest;
            assert_eq!(holds(film), rise > 0.045, "{}: {rise}", film.name());
        }
        let held = library.films().iter().filter(|film| holds(film)).count();
        assert!((3..=5).contains(&held), "{held} hold");
    }

    #[test]
    fn a_demonstration_begins_held_lost_held_and_rounds_show_all() {
        let library = FilmLibrary::built_in().unwrap();
        let count = library.films().len() as u64;
        for seed in 0..20 {
            let began = [0, 1, 2].map(|number| holds(&library.film(seed, number)));
            assert_eq!(began, [true, false, true]);
            for round in 0..3 {
                let mut names: Vec<_> = (0..count)
                    .map(|n| library.film(seed, round * count + n).name().to_owned())
                    .collect();
                names.sort();
                names.dedup();
                assert_eq!(names.len() as u64, count);
            }
        }
        let session = |seed| (0..24).map(move |n| (seed, n));
        let names = |seed| -> Vec<_> {
            session(seed)
                .map(|(s, n)| library.film(s, n).name().to_owned())
                .collect()
        };
        assert_eq!(names(1), names(1));
        assert!(names(1) != names(2), "later rounds follow the seed");
    }

    #[test]
    fn folders_without_films_are_explained() {
        let folder = tempfile::tempdir().unwrap();
        let text = FilmLibrary::read(folder.path()).unwrap_err().to_string();
        assert!(text.contains("render film"), "{text}");
        let lost = folder.path().join("lost");
        assert_eq!(
            FilmLibrary::read(&lost).unwrap_err().kind(),
            ErrorKind::NotFound
        );
        fs::write(folder.path().join("a.trace.bin"), b"no").unwrap();
        assert_eq!(
            FilmLibrary::read(folder.path()).unwrap_err().kind(),
            ErrorKind::NotFound
        );
    }

    #[test]
    fn damaged_films_are_refused_and_whole_ones_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let built_in = FilmLibrary::built_in().unwrap();
        let film = &built_in.films()[0];
        let write = |end: usize, bytes: &[u8]| {
            let files = film.files().named("grip");
            fs::write(folder.path().join(&files[end].0), bytes).unwrap();
        };
        let whole: Vec<Vec<u8>> = film
            .files()
            .named("")
            .iter()
            .map(|f| f.1.to_vec())
            .collect();
        for (end, bytes) in whole.iter().enumerate() {
            write(end, bytes);
        }
        let read = FilmLibrary::read(folder.path()).unwrap();
        assert_eq!(read.films()[0].name(), "grip");
        assert_eq!(read.films()[0].steps(), film.steps());
        for (end, bytes) in whole.iter().enumerate() {
            write(end, &bytes[..bytes.len() / 3]);
            let text = FilmLibrary::read(folder.path()).unwrap_err().to_string();
            assert!(text.contains("grip"), "{text}");
            write(end, bytes);
        }
    }
}
