//! Fault tests of scene files: every obtained scene must behave and look like a freshly compiled
//! scene.

use std::fs::{self, Permissions};
use std::os::unix::fs::{PermissionsExt, chown};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::Barrier;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use tempfile::TempDir;

use super::*;
use crate::error::SimError;
use crate::mujoco::{Data, ObjectKind};
use crate::render::{Canvas, Drawer, View};

const NAME: &str = "aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa";
const OTHER_NAME: &str = "bbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbb";

/// Variable with the folder in which a child of this test program obtains a scene.
const FOLDER: &str = "ROLLOUT_TEST_SCENES";

/// Sets the id of the user whose rights the calling thread has when it accesses files.
#[allow(unsafe_code, reason = "a call of the C library")]
fn access_files_as(user: u32) {
    unsafe extern "C" {
        fn setfsuid(user: u32) -> i32;
    }
    // SAFETY: the call has no preconditions and concerns this thread only.
    unsafe { setfsuid(user) };
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
    let prepared =
        |model: &Model| prepared.map_or_else(|| Prepared::from_model(model).map(Arc::new), Ok);
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

fn in_memory(model: Model) -> LoadedScene {
    LoadedScene { model, prepared: None }
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
            expected: behaviour(in_memory(compile(0.1).expect("a model"))),
        }
    }

    /// Checks the behaviour. Returns whether the scene was compiled, and whether a file is mapped.
    fn obtain(&self) -> (bool, bool) {
        let mut compiled = false;
        let obtained = self.folder.obtain(NAME, || {
            compiled = true;
            compile(0.1)
        });
        let obtained = obtained.expect("a scene");
        let mapped = obtained.model.lacks_texels();
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
        names.filter(|name| name.to_string_lossy().starts_with(folder::TEMPORARY)).count()
    }
}

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
        let obtained = fixture.folder.obtain(NAME, || unreachable!("the file exists"));
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
                let obtained = fixture.folder.obtain(NAME, || {
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
    let lock = fixture.folder.lock(&folder::lock_of(NAME));
    let lock = lock.expect("a lock");
    assert_eq!(fixture.obtain(), (true, false));
    let message = SceneFolder::take_problem().expect("a problem");
    assert!(message.contains("other processes have held"), "{message}");
    drop(lock);
    assert_eq!(fixture.obtain(), (true, true));
}

/// Runs [`obtain_in_a_child_process`], whose files may have up to `bytes`; a larger one kills it, or
/// fails if it is to ignore the signal.
fn obtain_in_child(fixture: &Fixture, bytes: u64, ignores_signal: bool) -> Output {
    let trap = if ignores_signal { "trap '' XFSZ;" } else { "" };
    let program = std::env::current_exe().expect("this program");
    let mut shell = Command::new("sh");
    shell.arg("-c").arg(format!("{trap} ulimit -f {}; exec \"$0\" \"$@\"", bytes / 512));
    shell.arg(program).args(["--ignored", "--exact", "--nocapture"]);
    shell.arg("scene_files::tests::obtain_in_a_child_process");
    shell.env(FOLDER, &fixture.folder.dir).output().expect("runs")
}

#[test]
#[ignore = "another test starts this test in a child process"]
fn obtain_in_a_child_process() {
    if let Some(dir) = std::env::var_os(FOLDER) {
        let obtained = SceneFolder::new(Path::new(&dir)).obtain(NAME, || compile(0.1));
        let mapped = obtained.expect("a scene").model.lacks_texels();
        println!("mapped {mapped}, {:?}", SceneFolder::take_problem());
    }
}

#[test]
fn a_full_disk_and_a_killed_writer_leave_no_incomplete_file() {
    let fixture = Fixture::new();
    let mut limits = 0;
    loop {
        let limit = limits * 2048;
        let full = obtain_in_child(&fixture, limit, true);
        let text = String::from_utf8_lossy(&full.stdout).into_owned();
        assert!(full.status.success(), "{limit}: {text}");
        assert_eq!(fixture.temporary_files(), 0, "{limit}");
        if text.contains("mapped true, None") {
            break;
        }
        assert!(text.contains("mapped false") && text.contains("ROLLOUT_SCENES=off"), "{text}");
        assert!(fixture.files(".scene").is_empty(), "{limit}");
        assert!(!obtain_in_child(&fixture, limit, false).status.success(), "{limit}: not killed");
        assert!(fixture.files(".scene").is_empty(), "killed at {limit}");
        assert_eq!(fixture.temporary_files(), 1, "killed at {limit}");
        assert_eq!(fixture.obtain(), (true, true), "killed at {limit}");
        assert_eq!(fixture.temporary_files(), 0, "killed at {limit}");
        fs::remove_dir_all(&fixture.folder.dir).expect("removed");
        limits += 1;
    }
    assert!(limits > 4, "the disk was full only below {limits} × 2 kB");
    assert_eq!(fixture.obtain(), (false, true));
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
            let unstored = fixture.folder.obtain(OTHER_NAME, || compile(0.1));
            let unstored = unstored.expect("a scene");
            assert!(!unstored.model.lacks_texels());
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
    let obtained = fixture.folder.obtain(OTHER_NAME, || compile(0.1));
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
fn the_least_recently_used_scenes_are_removed_and_stay_mapped() {
    let mut fixture = Fixture::new();
    let obtain = |fixture: &Fixture, name, size| {
        let obtained = fixture.folder.obtain(name, || compile(size));
        obtained.expect("a scene")
    };
    let first = obtain(&fixture, NAME, 0.1);
    let [scene] = &fixture.files(".scene")[..] else { panic!("one scene") };
    let bytes = fs::metadata(scene).expect("there").len();
    drop(obtain(&fixture, OTHER_NAME, 0.2));
    assert_eq!(fixture.obtain(), (false, true), "used again");
    fixture.folder.limit = 3 * bytes;
    drop(obtain(&fixture, "cccccccccccccccccccccccccccccccc", 0.3));
    let names = |fixture: &Fixture| {
        let files = fixture.files(".scene").into_iter();
        let first = |file: PathBuf| file.file_stem().expect("a name").to_string_lossy()[..1].into();
        let mut names: Vec<String> = files.map(first).collect();
        names.sort();
        names
    };
    assert_eq!(names(&fixture), ["a", "c"]);
    fixture.folder.limit = 0;
    drop(obtain(&fixture, "dddddddddddddddddddddddddddddddd", 0.4));
    assert_eq!(names(&fixture), ["d"]);
    assert_eq!(fixture.files(".texture").len(), 3);
    assert!(behaviour(first) == fixture.expected);
    assert_eq!(fixture.obtain(), (true, true), "the first scene was removed");
}
