//! Fault tests of scene files: every obtained scene must behave and look like a freshly compiled
//! scene.

use std::fs::{self, File, Permissions};
use std::io::{self, Seek, SeekFrom, Write};
use std::os::unix::fs::{PermissionsExt, chown};
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Barrier;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::time::Duration;

use rustix::process::{Signal, getpid, kill_process};
use tempfile::TempDir;

use super::*;
use crate::mujoco::{Data, ObjectKind};
use crate::render::{Canvas, Drawer, View};

const NAME: Name = [b'a'; NAME_DIGITS];
const OTHER_NAME: Name = [b'b'; NAME_DIGITS];

/// Variables of a child that is killed while it writes: scene folder, and bytes until then.
const KILLED_IN: &str = "ROLLOUT_TEST_KILLED_IN";
const KILLED_AT: &str = "ROLLOUT_TEST_KILLED_AT";

/// Sets the id of the user whose rights the calling thread has when it accesses files.
#[allow(unsafe_code, reason = "a call of the C library")]
fn access_files_as(user: u32) {
    unsafe extern "C" {
        fn setfsuid(user: u32) -> i32;
    }
    // SAFETY: the call has no preconditions and concerns this thread only.
    unsafe { setfsuid(user) };
}

/// Simulated disk: when full, a write fails, or kills the process if [`KILLED_AT`] is set.
pub(super) struct Disk<'a> {
    pub(super) file: &'a mut File,
    pub(super) room: &'a AtomicU64,
}

impl Write for Disk<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let room = self.room.load(Ordering::Relaxed);
        let written = bytes.len().min(room as usize);
        if written < bytes.len() && written == 0 {
            if std::env::var_os(KILLED_AT).is_some() {
                kill_process(getpid(), Signal::KILL).expect("a signal");
            }
            return Err(io::ErrorKind::StorageFull.into());
        }
        self.room.store(room - written as u64, Ordering::Relaxed);
        self.file.write(&bytes[..written])
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Seek for Disk<'_> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

/// A falling mesh and box, a plane, and three textures, two of them the same for every `size`.
fn compile(size: f64) -> Result<Model, SimError> {
    Model::compile(&format!(
        r#"<mujoco><asset>
          <mesh name="wedge" vertex="0 0 0  .3 0 0  0 .3 0  0 0 .3"/>
          <texture name="tiles" type="2d" builtin="checker" width="40" height="24" rgb1="1 0 0"/>
          <texture name="own" type="cube" builtin="gradient" width="8" height="8"
            rgb1="{size} 1 0" rgb2="0 0 1"/>
          <texture name="sky" type="skybox" builtin="gradient" width="16" height="16"/>
          <material name="tiles" texture="tiles" texrepeat="3 3"/>
          <material name="own" texture="own"/>
        </asset><worldbody>
          <light pos="0 0 3" castshadow="false"/>
          <camera name="front" pos="0 -1.5 .7" xyaxes="1 0 0 0 .3 1"/>
          <geom type="plane" size="1 1 .1" material="tiles"/>
          <body pos="0 0 .5"><freejoint/><geom type="mesh" mesh="wedge" material="own"/></body>
          <body pos=".1 0 1"><freejoint/><geom type="box" size="{size} .1 .1"/></body>
        </worldbody></mujoco>"#
    ))
}

/// Simulates half a second. Returns the final positions and a frame that shows them.
fn behaviour(obtained: LoadedScene) -> (Vec<f64>, Vec<u8>) {
    let LoadedScene { model: shared, prepared } = obtained;
    let mut model = shared.share();
    let mut data = Data::new(&model).expect("a state");
    for _ in 0..250 {
        data.step1(&model);
        data.step2(&model);
    }
    let prepared = |model: &Model| match prepared {
        Preparation::InFile(bytes) => Prepared::from_bytes(model, &bytes).map(Arc::new),
        Preparation::InMemory(prepared) => Ok(prepared),
        Preparation::Missing => Prepared::from_model(model).map(Arc::new),
    };
    let size = [64, 48];
    let mut canvas = Canvas::new(&Drawer::Software, &mut model, prepared, size).expect("a canvas");
    let view = View {
        camera: model.id(ObjectKind::Camera, "front").expect("a camera"),
        model: &model,
        data: &mut data,
        size,
    };
    let frame = canvas.draw(view).expect("a frame");
    (data.qpos(&model).to_vec(), frame)
}

struct Fixture {
    _temporary: TempDir,
    folder: SceneFolder,
    expected: (Vec<f64>, Vec<u8>),
}

impl Fixture {
    fn new() -> Self {
        let temporary = tempfile::tempdir().expect("a folder");
        Self {
            folder: SceneFolder::new(&temporary.path().join("scenes")),
            _temporary: temporary,
            expected: behaviour(LoadedScene::in_memory(compile(0.1).expect("a model"))),
        }
    }

    /// Checks the behaviour. Returns whether the scene was compiled, and whether a file is mapped.
    fn obtain(&self) -> (bool, bool) {
        let mut compiled = false;
        let obtained = self.folder.obtain(&NAME, || {
            compiled = true;
            compile(0.1)
        });
        let obtained = obtained.expect("a scene");
        let mapped = matches!(obtained.prepared, Preparation::InFile(_));
        assert!(behaviour(obtained) == self.expected, "the obtained scene behaves differently");
        (compiled, mapped)
    }

    fn files(&self, ending: &str) -> Vec<PathBuf> {
        let entries = fs::read_dir(&self.folder.dir).into_iter().flatten();
        let mut files: Vec<_> = entries.map(|entry| entry.expect("an entry").path()).collect();
        files.retain(|file| file.to_string_lossy().ends_with(ending));
        files
    }

    fn temporary_files(&self) -> usize {
        let entries = fs::read_dir(&self.folder.dir).into_iter().flatten();
        let names = entries.map(|entry| entry.expect("an entry").file_name());
        names.filter(|name| name.to_string_lossy().starts_with(folder::TEMPORARY_PREFIX)).count()
    }
}

/// Replaces a file by a modified copy with the same name.
fn tamper(file: &Path, change: impl FnOnce(&mut Vec<u8>)) {
    let mut bytes = fs::read(file).expect("read");
    change(&mut bytes);
    fs::remove_file(file).expect("removed");
    fs::write(file, bytes).expect("written");
    fs::set_permissions(file, Permissions::from_mode(0o444)).expect("read only");
}

#[test]
fn a_scene_is_compiled_once_and_its_file_gives_the_same_behaviour() {
    let fixture = Fixture::new();
    assert_eq!(fixture.obtain(), (true, true));
    assert_eq!(fixture.obtain(), (false, true));
    for file in fixture.files(".scene").iter().chain(&fixture.files(".texture")) {
        let mode = fs::metadata(file).expect("there").permissions().mode();
        assert_eq!(mode & 0o7777, 0o444, "{}", file.display());
    }
    let [compiled, mapped] = [compile(0.1).expect("a model"), {
        let obtained = fixture.folder.obtain(&NAME, || unreachable!("the file exists"));
        obtained.expect("a scene").model
    }];
    for (array, mapped_array) in compiled.arrays().iter().zip(&mapped.arrays()) {
        assert!(array.values == mapped_array.values, "{}", array.name);
    }
}

#[test]
fn concurrent_writers_compile_a_scene_once() {
    let fixture = Fixture::new();
    let (compiled, ready) = (AtomicUsize::new(0), Barrier::new(4));
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                ready.wait();
                let obtained = fixture.folder.obtain(&NAME, || {
                    compiled.fetch_add(1, Ordering::Relaxed);
                    compile(0.1)
                });
                assert!(behaviour(obtained.expect("a scene")) == fixture.expected);
            });
        }
    });
    assert_eq!(compiled.into_inner(), 1);
}

#[test]
fn waiting_for_a_stalled_writer_times_out() {
    let mut fixture = Fixture::new();
    fixture.folder.max_wait = Duration::from_millis(30);
    let lock = fixture.folder.lock(&format!("{}.lock", name_text(&NAME)));
    let lock = lock.expect("a lock");
    assert_eq!(fixture.obtain(), (true, false));
    let message = SceneFolder::take_problem().expect("a problem");
    assert!(message.contains("other processes have held"), "{message}");
    drop(lock);
    assert_eq!(fixture.obtain(), (true, true));
}

#[test]
fn a_reader_that_locks_a_scene_blocks_no_other_reader() {
    let fixture = Fixture::new();
    fixture.obtain();
    let locked = File::open(&fixture.files(".scene")[0]).expect("readable");
    locked.lock().expect("a lock");
    let folder = SceneFolder::new(&fixture.folder.dir);
    let (sender, loaded) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        let obtained = folder.load(&NAME).expect("reads").expect("is there");
        sender.send(behaviour(obtained)).expect("awaited");
    });
    let behaviour = loaded.recv_timeout(Duration::from_secs(10));
    assert!(behaviour.expect("loading does not wait for the lock") == fixture.expected);
}

#[test]
fn a_full_disk_leaves_no_incomplete_file() {
    let fixture = Fixture::new();
    let mut full_at = 0;
    loop {
        fixture.folder.room.store(full_at, Ordering::Relaxed);
        let (compiled, mapped) = fixture.obtain();
        assert!(compiled, "a disk of {full_at} bytes holds a whole scene");
        assert_eq!(fixture.temporary_files(), 0, "full at {full_at}");
        if mapped {
            break;
        }
        assert!(fixture.files(".scene").is_empty(), "full at {full_at}");
        full_at += 6000;
    }
    assert!(full_at > 12_000, "the disk was full only below {full_at} bytes");
    let message = SceneFolder::take_problem().expect("a problem");
    assert!(message.contains(".texture") && message.contains("ROLLOUT_SCENES=off"), "{message}");
    assert_eq!(SceneFolder::take_problem(), None, "reported twice");
    assert_eq!(fixture.obtain(), (false, true));
}

#[test]
fn a_killed_writer_leaves_no_incomplete_file() {
    if let (Some(dir), Ok(at)) = (std::env::var_os(KILLED_IN), std::env::var(KILLED_AT)) {
        let folder = SceneFolder::new(Path::new(&dir));
        folder.room.store(at.parse().expect("bytes"), Ordering::Relaxed);
        folder.obtain(&NAME, || compile(0.1)).expect("a scene");
        return;
    }
    let fixture = Fixture::new();
    let name = "scene_files::tests::a_killed_writer_leaves_no_incomplete_file";
    let mut killed_at = 0;
    loop {
        let mut writer = Command::new(std::env::current_exe().expect("this program"));
        writer.args(["--exact", name]);
        writer.env(KILLED_IN, &fixture.folder.dir);
        writer.env(KILLED_AT, killed_at.to_string());
        let ended = writer.output().expect("it runs").status;
        if ended.success() {
            break;
        }
        assert_eq!(ended.signal(), Some(Signal::KILL.as_raw()), "{killed_at}");
        assert!(fixture.files(".scene").is_empty(), "killed at {killed_at}");
        assert_eq!(fixture.obtain(), (true, true), "killed at {killed_at}");
        assert_eq!(fixture.temporary_files(), 0, "killed at {killed_at}");
        fs::remove_dir_all(&fixture.folder.dir).expect("removed");
        killed_at += 6000;
    }
    assert!(killed_at > 12_000, "the writer was killed only below {killed_at} bytes");
    assert_eq!(fixture.obtain(), (false, true));
}

#[test]
fn temporary_files_of_a_crashed_writer_are_ignored_and_removed() {
    let fixture = Fixture::new();
    fixture.obtain();
    let whole = fs::read(&fixture.files(".scene")[0]).expect("read");
    for length in [0, 40, whole.len() / 2, whole.len()] {
        fs::remove_dir_all(&fixture.folder.dir).expect("removed");
        fixture.folder.check().expect("a folder");
        let temporary = fixture.folder.dir.join(format!("{}left", folder::TEMPORARY_PREFIX));
        fs::write(temporary, &whole[..length]).expect("written");
        assert_eq!(fixture.obtain(), (true, true), "{length} bytes");
        assert_eq!(fixture.temporary_files(), 0, "{length} bytes");
    }
}

#[test]
fn a_truncated_or_changed_file_is_compiled_again() {
    let fixture = Fixture::new();
    fixture.obtain();
    let mut files = fixture.files(".scene");
    files.extend(fixture.files(".texture"));
    assert_eq!(files.len(), 4);
    for file in files {
        let length = fs::metadata(&file).expect("there").len() as usize;
        for cut in [0, 20, 100, length - 1] {
            tamper(&file, |bytes| bytes.truncate(cut));
            assert_eq!(
                fixture.obtain(),
                (true, true),
                "truncated to {cut} bytes: {}",
                file.display()
            );
        }
        for at in [0, 17, 50, 70, 90, 200, length / 2, length - 1] {
            tamper(&file, |bytes| bytes[at] ^= 0x81);
            assert_eq!(fixture.obtain(), (true, true), "byte {at} changed in {}", file.display());
        }
        fs::remove_file(&file).expect("removed");
        assert_eq!(fixture.obtain(), (true, true), "{} removed", file.display());
    }
    assert_eq!(fixture.obtain(), (false, true));
}

#[test]
fn a_checksum_check_is_recorded_and_repeated_if_the_record_is_missing() {
    let fixture = Fixture::new();
    fixture.obtain();
    let [record] = &fixture.files(".checked")[..] else {
        panic!("one record");
    };
    let recorded = fs::read_to_string(record).expect("read");
    assert_eq!(recorded.lines().count(), 4);
    fs::remove_file(record).expect("removed");
    assert_eq!(fixture.obtain(), (false, true));
    assert_eq!(fs::read_to_string(record).expect("read"), recorded);
}

#[test]
fn scenes_stay_in_memory_if_the_folder_cannot_be_created() {
    let mut fixture = Fixture::new();
    // Not even root can create a folder in `/proc`.
    fixture.folder.dir = "/proc/rollout-scenes".into();
    assert_eq!(fixture.obtain(), (true, false));
    let error = fixture.folder.check().expect_err("no folder").to_string();
    assert!(error.starts_with("create /proc/rollout-scenes: "), "{error}");
}

#[test]
fn a_read_only_folder_is_read_and_never_written() {
    let fixture = Fixture::new();
    fixture.obtain();
    let (above, dir) = (fixture._temporary.path(), &fixture.folder.dir);
    for dir in [above, dir] {
        fs::set_permissions(dir, Permissions::from_mode(0o555)).expect("rights");
    }
    std::thread::scope(|scope| {
        let reader = scope.spawn(|| {
            if fixture.folder.user == 0 {
                // Root may write everywhere, so this thread reads with the rights of another user.
                access_files_as(12_345);
            }
            assert_eq!(fixture.obtain(), (false, true));
            let unstored = fixture.folder.obtain(&OTHER_NAME, || compile(0.1));
            let unstored = unstored.expect("a scene");
            assert!(!matches!(unstored.prepared, Preparation::InFile(_)));
            assert!(behaviour(unstored) == fixture.expected);
        });
        reader.join().expect("the reader's assertions hold");
    });
    let message = SceneFolder::take_problem().expect("a problem");
    assert!(message.contains("Permission denied"), "{message}");
    assert_eq!(fixture.files(".scene").len(), 1);
    for dir in [above, dir] {
        fs::set_permissions(dir, Permissions::from_mode(0o700)).expect("rights");
    }
}

#[test]
fn a_folder_that_others_own_or_may_write_to_is_not_used() {
    let mut fixture = Fixture::new();
    fixture.obtain();
    let dir = fixture.folder.dir.clone();
    fs::set_permissions(&dir, Permissions::from_mode(0o777)).expect("rights");
    assert_eq!(fixture.obtain(), (true, false));
    let error = fixture.folder.check().expect_err("writable").to_string();
    assert!(error.contains("its mode is 777"), "{error}");
    fs::set_permissions(&dir, Permissions::from_mode(0o700)).expect("rights");
    assert_eq!(fixture.obtain(), (false, true));
    match fixture.folder.user {
        0 => chown(&dir, Some(12_345), None).expect("a changed owner"),
        user => fixture.folder.user = user + 1,
    }
    assert_eq!(fixture.obtain(), (true, false));
    let error = fixture.folder.check().expect_err("owned by another user").to_string();
    assert!(error.contains("user ") && error.contains("owns it"), "{error}");
}

#[test]
fn a_file_that_others_may_write_to_is_replaced() {
    let fixture = Fixture::new();
    fixture.obtain();
    let scene = &fixture.files(".scene")[0];
    fs::set_permissions(scene, Permissions::from_mode(0o666)).expect("rights");
    assert_eq!(fixture.obtain(), (true, true));
    assert_eq!(fixture.obtain(), (false, true));
}

#[test]
fn programs_with_different_layouts_use_separate_texture_files() {
    let mut fixture = Fixture::new();
    fixture.obtain();
    let before = fixture.files(".texture");
    fixture.folder.layout += "another";
    // Another program would also use other scene names; `OTHER_NAME` stands for one of them.
    let obtained = fixture.folder.obtain(&OTHER_NAME, || compile(0.1));
    assert!(behaviour(obtained.expect("a scene")) == fixture.expected);
    assert_eq!(fixture.files(".texture").len(), 2 * before.len());
    assert_eq!(fixture.obtain(), (false, true));
}

#[test]
fn an_unusable_limit_is_refused_with_its_text() {
    assert_eq!(folder::limit(None).expect("the default"), 16 << 30);
    assert_eq!(folder::limit(Some("3")).expect("a number"), 3 << 30);
    for given in ["8G", "0.5", "18446744073709551615"] {
        let error = folder::limit(Some(given)).expect_err("unusable");
        assert!(error.to_string().contains(given), "{error}");
    }
}

#[test]
fn eviction_removes_the_oldest_scene_that_is_not_mapped() {
    let mut fixture = Fixture::new();
    let obtain = |fixture: &Fixture, name, size| {
        let obtained = fixture.folder.obtain(name, || compile(size));
        obtained.expect("a scene")
    };
    let first = obtain(&fixture, &NAME, 0.1);
    fixture.folder.limit = 0;
    let names = |fixture: &Fixture| -> Vec<String> {
        let files = fixture.files(".scene").into_iter();
        let mut names: Vec<_> = files
            .map(|file| file.file_stem().expect("a name").to_string_lossy()[..1].to_owned())
            .collect();
        names.sort();
        names
    };
    drop(obtain(&fixture, &OTHER_NAME, 0.2));
    assert_eq!(names(&fixture), ["a", "b"], "the first scene is mapped, the second is new");
    drop(obtain(&fixture, &[b'c'; NAME_DIGITS], 0.3));
    assert_eq!(names(&fixture), ["a", "c"], "the second scene is not mapped");
    assert_eq!(fixture.files(".texture").len(), 4);
    assert!(behaviour(first) == fixture.expected);
    drop(obtain(&fixture, &[b'd'; NAME_DIGITS], 0.4));
    assert_eq!(names(&fixture), ["d"]);
    assert_eq!(fixture.files(".checked").len(), 1);
    assert_eq!(fixture.obtain(), (true, true), "the first scene was evicted");
}
