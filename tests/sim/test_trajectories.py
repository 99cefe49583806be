"""Speckle of objects that turn, move along the line of sight, or follow a list of positions, and of a moving camera, in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

pytest.importorskip("mitsuba")

import correlograph as cg
from correlograph.errors import InputError
from radiometry.motion import airy
from sim.frame import Simulation
from sim.geometry import Movement
from sim.laser_speckle import grain_m
from sim.plan import Settings
from sim.rendering import lag_grid_albedo, motion_of, moved_albedo
from sim.trajectory import Trajectory, read_trajectory

EVEN = Settings(effects=(("pupil_and_pixel", False), ("source_grain", False), ("motion", True)))
"""Even illumination: all that changes is the length of the paths."""

INTERVAL_S = 10.0


@pytest.fixture
def still(scene):
    """The reference scene on a small frame, with the laser at rest and ten seconds between frames of a tenth of a millisecond."""
    geometry = scene().with_exposure(1e-4)
    camera = replace(geometry.camera, frame_interval_s=INTERVAL_S)
    return replace(geometry, camera=camera, spot=replace(geometry.spot, scan_step_m=0.0))


def lit_along_the_line_of_sight(geometry, distance_m=0.5):
    """The laser spot between object and wall, or behind the wall, on the line of sight, so that its light comes from there."""
    centre = geometry.hidden_object.centre - distance_m * geometry.hidden_object.line_of_sight
    return replace(geometry, spot=replace(geometry.spot, centre=centre))


def turning(geometry, degrees):
    """The object turns about the line of sight, from the axis of rows towards that of columns, between two frames."""
    axis = np.cross(geometry.hidden_object.axes.down, geometry.hidden_object.axes.right)
    return moving(geometry, Trajectory(turn_deg_s=axis * degrees / INTERVAL_S))


def moving(geometry, path):
    return replace(geometry, movements=(Movement(path, geometry.hidden_object.centre),))


def listed(*ways):
    """A motion through places (3,), one interval between them."""
    times = INTERVAL_S * np.arange(len(ways))
    return Trajectory(times_s=times, displacement_m=np.stack(ways), rotation_deg=np.zeros((len(ways), 3)))


def two_frames(geometry, settings=EVEN, seeds=(3,)):
    """The expected frames 0 and 1, (seeds, H, W) each; (H, W) for one seed."""
    simulation = Simulation(geometry, settings)
    frames = [[simulation.expected_frame(seed, number).numpy().astype(float) for seed in seeds] for number in (0, 1)]
    return [np.squeeze(np.array(one), 0) if len(seeds) == 1 else np.array(one) for one in frames]


def likeness(first, second):
    return float(np.corrcoef(first.ravel(), second.ravel())[0, 1])


def shift_between(first, second):
    """Displacement of the speckle in pixels (rows, columns) between frames (H, W) or (seeds, H, W): the maximum of the
    cross-correlation of their windowed middles, by a parabola."""
    first, second = (np.atleast_3d(images.T).T for images in (first, second))
    window = np.outer(*(np.hanning(side) for side in first.shape[-2:]))
    spectra = [np.fft.fft2((images - images.mean((1, 2), keepdims=True)) * window) for images in (first, second)]
    correlation = np.fft.fftshift(np.fft.ifft2((spectra[0].conj() * spectra[1]).sum(0)).real)
    overlap = np.fft.fftshift(np.fft.ifft2(np.abs(np.fft.fft2(window)) ** 2).real)
    correlation = correlation / np.maximum(overlap, 0.3 * overlap.max())
    row, column = np.unravel_index(int(correlation.argmax()), correlation.shape)
    lines = (correlation[row - 1 : row + 2, column], correlation[row, column - 1 : column + 2])
    finer = [0.5 * (after - before) / (2.0 * here - before - after) for before, here, after in lines]
    return np.array([row, column]) - np.array(correlation.shape) // 2 + finer


def turned(image, degrees, about=(0.0, 0.0)):
    """The image turned from the axis of rows towards that of columns, about a point in pixels from its centre."""
    angle, middle = np.radians(degrees), 0.5 * (np.array(image.shape) - 1.0) + about
    row, column = np.mgrid[: image.shape[0], : image.shape[1]] - middle[:, None, None]
    source = np.stack([np.cos(angle) * row + np.sin(angle) * column, -np.sin(angle) * row + np.cos(angle) * column])
    return map_coordinates(image, source + middle[:, None, None], order=3, mode="nearest")


INNER = (slice(60, -60), slice(60, -60))


@pytest.mark.parametrize("degrees", [2.0, -2.0])
def test_speckle_turns_with_the_object(still, degrees):
    """The patterns turn by the same angle, about the frame centre if the light comes along the line of sight."""
    first, second = two_frames(turning(lit_along_the_line_of_sight(still), degrees))
    assert likeness(turned(first, degrees)[INNER], second[INNER]) > 0.9
    assert likeness(turned(first, -degrees)[INNER], second[INNER]) < 0.2


def test_speckle_turns_about_the_mirror_image_of_oblique_light(still):
    """Light from a direction s turns the speckle about the point of the wall that a mirror would send it to, -z s across the line of
    sight: at 12 degrees 0.2 m away, so that a tenth of a degree moves it by 0.4 mm."""
    hidden = still.hidden_object
    to_spot = (still.spot.centre - hidden.centre) / still.source_distance_m
    mirror = -still.distance_m * np.array([to_spot @ hidden.axes.down, to_spot @ hidden.axes.right]) / still.seen_pitch_m
    assert abs(mirror).max() > 10_000
    first, second = two_frames(turning(still, 0.1))
    assert likeness(turned(first, 0.1, mirror)[INNER], second[INNER]) > 0.9
    assert likeness(turned(first, 0.1)[INNER], second[INNER]) < 0.2


@pytest.mark.slow
def test_illumination_decorrelates_a_turned_object(still):
    """Uneven light: scatterers at radius r have moved by r times the angle through grains of lambda d1 / D, here 53 um."""
    alike = []
    for degrees in (0.1, 2.0):
        scene = turning(lit_along_the_line_of_sight(still), degrees)
        first, second = two_frames(scene, Settings(effects=(("pupil_and_pixel", False), ("motion", True))))
        alike.append(likeness(turned(first, degrees)[INNER], second[INNER]))
    assert alike[0] > 0.8
    assert alike[1] < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("way", [2.5e-3, -2.5e-3])
def test_speckle_spreads_when_the_object_recedes(still, way):
    """Halves of the frame, whose centres are half a frame apart, move apart by w / z of that. (Near light would blur this.)"""
    path = Trajectory(velocity_m_s=still.hidden_object.line_of_sight * way / INTERVAL_S)
    first, second = two_frames(moving(lit_along_the_line_of_sight(still, 50.0), path), seeds=range(4))
    height, width = first.shape[-2:]
    apart = [
        shift_between(first[:, *half], second[:, *half])[axis]
        for axis, halves in enumerate(
            (
                ((slice(0, height // 2), slice(None)), (slice(height // 2, None), slice(None))),
                ((slice(None), slice(0, width // 2)), (slice(None), slice(width // 2, None))),
            )
        )
        for half in halves
    ]
    expected = way / still.distance_m * 0.5 * np.array((height, width))
    np.testing.assert_allclose([apart[1] - apart[0], apart[3] - apart[2]], expected, atol=0.15 * np.abs(expected).max())


def test_a_list_of_positions_is_followed(still, tmp_path):
    """Across the line of sight by u (1 + z / d1), and by u (1 + cos^2 z / d1) in the plane of light that comes at an angle."""
    hidden = still.hidden_object
    to_spot = (still.spot.centre - hidden.centre) / still.source_distance_m
    cosine2, lever = 1.0 - (to_spot @ hidden.axes.right) ** 2, still.distance_m / still.source_distance_m
    assert cosine2 == pytest.approx(np.cos(np.radians(12.0)) ** 2, rel=1e-3)
    steps = np.array([60e-6, -45e-6])
    ways = np.outer([0.0, 2.0], steps @ np.stack([hidden.axes.down, hidden.axes.right]))
    lines = [f"{time},{','.join(map(str, way))}" for time, way in zip((0, 20), ways, strict=True)]
    file = tmp_path / "path.csv"
    file.write_text("\n".join(["time_s,x_m,y_m,z_m", *lines]))
    first, second = two_frames(moving(still, read_trajectory(file, "trajectory")), seeds=range(4))
    expected = steps * (1.0 + lever * np.array([1.0, cosine2])) / still.seen_pitch_m
    np.testing.assert_allclose(still.travel @ steps, expected, rtol=1e-3)
    np.testing.assert_allclose(shift_between(first, second), expected, rtol=0.01)


def test_a_camera_that_moves_sees_the_same_speckle_displaced(still):
    """The speckle moves by the displacement of the camera, whatever the distances."""
    pitch = still.camera.pixel_pitch_m
    way = 4.0 * pitch * still.camera.down + 7.0 * pitch * still.camera.right
    camera = replace(still.camera, trajectory=Trajectory(velocity_m_s=way / INTERVAL_S))
    np.testing.assert_allclose(
        shift_between(*two_frames(replace(still, camera=camera), seeds=range(4))), [-4.0, -7.0], atol=0.1
    )


def test_turned_and_receding_samples_are_where_the_trajectory_says(still):
    """Positions of samples: R (p - c) + c + u, with a list and a constant rate together."""
    path = Trajectory(
        velocity_m_s=np.array([1e-3, -2e-3, 5e-4]),
        turn_deg_s=np.array([0.0, 0.0, 9.0]),
        times_s=np.array([0.0, 4.0]),
        displacement_m=np.array([[0.0, 0.0, 0.0], [0.0, 4e-3, 0.0]]),
        rotation_deg=np.array([[0.0, 0.0, 0.0], [40.0, 0.0, 0.0]]),
    )
    np.testing.assert_allclose(path.displacement(2.0), [2e-3, -2e-3, 1e-3])
    np.testing.assert_allclose(path.displacement(8.0), [8e-3, -1.2e-2, 4e-3])
    expected = Rotation.from_euler("z", 18.0, degrees=True) * Rotation.from_euler("x", 20.0, degrees=True)
    np.testing.assert_allclose(path.rotation(2.0).as_matrix(), expected.as_matrix(), atol=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_s,x_m,y_m\n0,0,0\n", "columns"),
        ("time_s,x_m,y_m,z_m\n", "rows"),
        ("time_s,x_m,y_m,z_m\n0,0,0,0\n2,1,0,0\n1,2,0,0\n", "1 s after 2 s"),
        ("time_s,x_m,y_m,z_m\n0,nan,0,0\n", "finite"),
        ("time_s,x_m,y_m,z_m\n0,1e300,0,0\n", "up to"),
        ("time_s,x_m,y_m,z_m\n0,0,0,0\n1e-3,1e6,0,0\n", "that of light"),
        ("time_s,x_m,y_m,z_m\n0," + 200_000 * "9" + ",0,0\n", "field"),
        ("time_s,x_m,y_m,z_m\n0,0,0\n", "finite"),
        ("time_s,x_m,y_m,z_m\n0,0,zero,0\n", "zero"),
        ("", "CSV"),
        ("time_s,x_m,y_m,z_m,rx_deg,ry_deg,rz_deg\n0,0,0,0,0,0,0\n1,0,0,0,0,0,720\n", "half a turn"),
        ("time_s,x_m,y_m,z_m,rx_deg,ry_deg,rz_deg\n0,0,0,0,0,0,1e300\n", "degrees"),
    ],
)
def test_malformed_lists_are_refused(tmp_path, text, message):
    (tmp_path / "path.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        read_trajectory(tmp_path / "path.csv", "phase_screen.trajectory")


def test_a_byte_order_mark_and_a_vector_that_changes_sign_at_half_a_turn_are_read(tmp_path):
    text = "time_s,x_m,y_m,z_m,rx_deg,ry_deg,rz_deg\n0,0,0,0,0,0,170\n1,0,0,0,0,0,-170\n"
    (tmp_path / "path.csv").write_text(text, encoding="utf-8-sig")
    turn = read_trajectory(tmp_path / "path.csv", "phase_screen.trajectory").rotation(0.5)
    assert np.degrees(turn.magnitude()) == pytest.approx(180.0)


def test_an_object_that_reaches_the_wall_is_refused(still):
    """0.95 m in ten seconds, towards a wall one metre away; the first frame is that of an object at rest."""
    geometry = moving(still, Trajectory(velocity_m_s=-0.095 * still.hidden_object.line_of_sight)).with_exposure(1e-6)
    simulation = Simulation(geometry, EVEN)
    with pytest.raises(
        InputError, match=r"motion: expected an object 0\.1 m or more from the virtual detector, found 0\.05 m after 10 s"
    ):
        simulation.expected_frame(3, 1)


SQUARE = """
    <shape type="rectangle" id="hidden_object_{name}">
        <transform name="to_world"><scale x="4e-4" y="6e-4"/><rotate z="1" angle="180"/><translate x="{x}" y="{y}"/></transform>
        <bsdf type="phase_screen">
            <float name="height_rms" value="2e-6"/><float name="correlation_length" value="10e-6"/>
            <vector name="velocity" value="{velocity}"/>
            <bsdf type="diffuse"><spectrum name="reflectance" value="0.8"/></bsdf>
        </bsdf>
    </shape>
"""


@pytest.fixture
def two_squares(tmp_path):
    """two_squares(speed, exposure) -> Geometry of two small objects 3 mm and 1 mm apart that leave each other; a frame per second."""
    from scenes import scene_path

    def make(speed: float, exposure: float):
        text = scene_path("corner_letter").read_text()
        begin, end = text.index("    <!-- 1 cm square"), text.index("    <!-- the wall that the camera")
        squares = SQUARE.format(name="1", x=-1.5e-3, y=0, velocity=f"{-speed}, 0, 0")
        squares += SQUARE.format(name="2", x=1.5e-3, y=1e-3, velocity=f"{speed}, 0, 0")
        text = text[:begin] + squares + text[end:]
        text = text.replace('value="2464"', 'value="616"').replace('value="2056"', 'value="514"')
        text = text.replace('<float name="pixel_pitch"', '<float name="frame_interval" value="1"/><float name="pixel_pitch"')
        (tmp_path / "scene.xml").write_text(text)
        return cg.load(tmp_path / "scene.xml", exposure=exposure).geometry

    return make


def power_of_frames(simulation, number, seeds):
    power = 0.0
    for seed in range(seeds):
        image = simulation.expected_frame(seed, number).numpy().astype(float)
        power = power + np.abs(np.fft.fft2(image / image.mean() - 1.0)) ** 2
    return np.fft.fftshift(power)


def around_lag(power, geometry, row_m, column_m):
    """The power at lags up to 20 rows and 8 columns from a displacement of the object, and the metres of a row and a column."""
    shape, steps = np.array(geometry.camera.frame_shape), np.array(geometry.seen_pitch_m)
    lag_m = geometry.wavelength_m * geometry.distance_m / (shape * steps)
    row, column = (shape // 2 + np.round(np.array([row_m, column_m]) / lag_m)).astype(int)
    return power[row - 20 : row + 21, column - 8 : column + 9], lag_m


def test_two_objects_move_apart(two_squares):
    """Cross terms of the autocorrelation of frames appear at the lag of their distance, which grows with time."""
    speed = 1e-3
    geometry = two_squares(speed, 1e-4)
    assert len(geometry.movements) == 2
    assert geometry.moves_on_lattice
    simulation = Simulation(geometry, EVEN)
    for number in (0, 1):
        power = power_of_frames(simulation, number, seeds=3)
        window, lag_m = around_lag(power, geometry, 0.0, 3e-3 + 2.0 * speed * number)
        window = (window - np.median(power)).clip(0.0) ** 2
        row = np.average(np.arange(-20, 21), weights=window.sum(1))
        column = np.average(np.arange(-8, 9), weights=window.sum(0))
        assert column * lag_m[1] == pytest.approx(0.0, abs=2e-4)
        assert abs(row) * lag_m[0] == pytest.approx(1e-3, abs=2e-4)


@pytest.mark.parametrize("propagator", ["fresnel", "nufft"])
def test_objects_that_move_apart_send_the_same_light_by_any_propagator(two_squares, propagator):
    """Fields of objects on one lattice, each with the phase of its displacement, against samples at their true positions."""
    geometry = two_squares(1e-3, 1e-4)
    frames = [
        Simulation(geometry, replace(EVEN, propagator=name, accuracy="field", tolerance=1e-3)).expected_frame(3, 1).numpy()
        for name in ("direct", propagator)
    ]
    assert likeness(*frames) > (0.995 if propagator == "nufft" else 0.97)


@pytest.mark.slow
@pytest.mark.parametrize(("speed", "interferes"), [(1e-6, True), (4e-5, True), (3e-4, False)])
def test_objects_of_different_speed_beat_until_their_doppler_shifts_differ(two_squares, speed, interferes):
    """Light from 12 degrees: the paths differ by 2 v T sin(12 degrees), and the cross terms fall by the square of the sinc of that."""
    exposure = 0.125
    geometry = two_squares(speed, exposure)
    simulation = Simulation(geometry, EVEN)
    assert (simulation.plan.modes.objects == (None,)) == interferes
    power = power_of_frames(simulation, 0, seeds=3)
    cross, own = (around_lag(power, geometry, row, column)[0].sum() for row, column in ((0.0, 3e-3), (0.0, 0.0)))
    floor = np.median(power) * 41 * 17
    turns = 2.0 * speed * exposure * np.sin(np.radians(12.0)) / geometry.wavelength_m
    # Two equal objects: each of two cross terms has half the power of the own ones.
    assert (cross - floor) / (own - floor) == pytest.approx(0.5 * np.sinc(turns) ** 2, abs=0.08)


def test_the_truth_of_each_frame_is_the_moved_one(still):
    """A quarter turn of the letter is its picture turned; a displacement by whole cells moves it; at rest nothing changes."""
    rest, pitches = lag_grid_albedo(still)
    assert np.corrcoef(moved_albedo(moving(still, Trajectory()), 0.0).ravel(), rest.ravel())[0, 1] > 0.98
    hidden = still.hidden_object
    quarter = np.cross(hidden.axes.down, hidden.axes.right) * 90.0
    shown = moved_albedo(moving(still, Trajectory(turn_deg_s=quarter)), 1.0)
    # From the axis of rows towards that of columns: what was below the centre is right of it.
    alike = [np.corrcoef(shown.ravel(), np.rot90(rest, turns).ravel())[0, 1] for turns in range(4)]
    assert int(np.argmax(alike)) == 1
    assert alike[1] > 0.95
    way = 3.0 * pitches[0] * hidden.axes.down - 5.0 * pitches[1] * hidden.axes.right
    shown = moved_albedo(moving(still, Trajectory(velocity_m_s=way)), 1.0)
    assert np.corrcoef(shown.ravel(), np.roll(rest, (3, -5), (0, 1)).ravel())[0, 1] > 0.98
    assert shown.sum() == pytest.approx(rest.sum(), rel=0.01)
    # From a quarter farther away, it looks four fifths as large.
    shown = moved_albedo(moving(still, Trajectory(velocity_m_s=0.25 * hidden.line_of_sight * still.distance_m)), 1.0)
    cells = np.indices(rest.shape)
    spread, before = ([np.sqrt(np.cov(one.ravel(), aweights=image.ravel())) for one in cells] for image in (shown, rest))
    np.testing.assert_allclose(spread, 0.8 * np.array(before), rtol=0.03)


def test_the_record_of_a_capture_tells_where_everything_was(still):
    hidden = still.hidden_object
    axis = np.cross(hidden.axes.down, hidden.axes.right)
    path = Trajectory(velocity_m_s=2e-4 * hidden.axes.down - 1e-4 * hidden.line_of_sight, turn_deg_s=3.0 * axis)
    told = motion_of(moving(still, path), 3)
    assert [one["time_s"] for one in told] == pytest.approx([5e-5, 10.00005, 20.00005])
    np.testing.assert_allclose(
        told[1]["objects"][0]["displacement_m"], np.array([2e-4, 0.0, -1e-4]) * told[1]["time_s"], atol=1e-9
    )
    np.testing.assert_allclose(np.abs(told[1]["objects"][0]["rotation_deg"]), [0.0, 0.0, 3.0 * told[1]["time_s"]], atol=1e-6)
    assert motion_of(still, 3) == []


@pytest.mark.parametrize("facing", [True, False])
@pytest.mark.parametrize("along", ["columns", "sight"])
def test_what_lies_across_the_ray_crosses_the_light(still, along, facing):
    """The laser's light comes at the angle a of 60 degrees to the line of sight, in the plane of the columns.

    Displaced by u across it or by w along it, the object crosses u cos a or w sin a of the grains; less by cos a on a wall that does not
    face it, on which the spot looks narrower. Intensities correlate by those of an evenly lit spot, the square of (2 J1(x) / x)^2 with
    x = pi (way) / grain.
    """
    hidden, angle = still.hidden_object, np.radians(60.0)
    line, right = hidden.line_of_sight, hidden.axes.right / np.linalg.norm(hidden.axes.right)
    ray = np.cos(angle) * line + np.sin(angle) * right
    normal = ray if facing else line
    geometry = replace(still, spot=replace(still.spot, centre=hidden.centre - 0.5 * ray, normal=normal))
    share = {"columns": np.cos(angle), "sight": np.sin(angle)}[along] * (1.0 if facing else np.cos(angle))
    way = 0.5 * grain_m(geometry) / max(share, 0.3)
    x = np.pi * way * share / grain_m(geometry)
    settings = Settings(effects=(("pupil_and_pixel", False), ("source_grain", True), ("motion", True)))
    path = Trajectory({"columns": right, "sight": line}[along] * way / INTERVAL_S)
    first, second = two_frames(moving(geometry, path), settings, seeds=range(6))
    alike = np.mean([shifted_likeness(*pair) for pair in zip(first, second, strict=True)])
    assert alike == pytest.approx(airy(x) ** 2, abs=0.08)


def shifted_likeness(first, second):
    """The correlation of two frames (H, W) at the displacement of the speckle between them."""
    rows, columns = np.round(shift_between(first, second)).astype(int)
    inside = np.s_[40:-40, 40:-40]
    return likeness(first[inside], np.roll(second, (-rows, -columns), (0, 1))[inside])


def test_the_wall_does_not_repeat_under_a_moving_camera(still):
    """The camera moves by a period of the frame at rest, and sees another part of the wall."""
    rows, _ = still.period_shape
    pixel = still.camera.down * still.camera.pixel_pitch_m
    moved = replace(still, camera=replace(still.camera, trajectory=listed(0.0 * pixel, rows * pixel)))
    assert moved.period_shape[0] >= rows + moved.canvas_shape[0]
    first, second = two_frames(moved)
    assert abs(likeness(first, second)) < 0.15


def test_a_constant_motion_beyond_what_is_foreseen_is_refused(still):
    """After ten seconds, an object of 1 cm at 2 mm/s has moved by 2 cm; the laser's light repeats after 1.25 cm."""
    down = still.hidden_object.axes.down
    with pytest.raises(InputError, match=r"motion: expected an object that moves by .* at most"):
        Simulation(moving(still, Trajectory(2e-3 * down)), EVEN).expected_frame(3, 1)


def test_a_listed_motion_is_judged_at_each_of_its_times(still):
    """A motion along the line of sight, and a wide one across it later: the first is not small beside the second."""
    line, down = still.hidden_object.line_of_sight, still.hidden_object.axes.down
    assert not moving(still, listed(0.0 * line, 3e-3 * line, 3e-3 * line + 1e-2 * down)).moves_on_lattice
    assert moving(still, listed(0.0 * down, 1e-2 * down)).moves_on_lattice


def test_an_object_is_not_hidden_by_its_place_at_rest():
    """It recedes by three of its widths. Light and detector see it as before, but for its distance."""
    scene = cg.load("moving_letter", velocity="0, 0, 0")
    hidden = scene.geometry.hidden_object
    visible = hidden.visible_from(scene.geometry.camera.centre, scene.geometry.camera.centre - hidden.centre)
    assert visible is not None
    places = scene.geometry.camera.centre - hidden.centre + np.array([[0.0, 0.0, 0.0], [1e-3, 2e-3, 0.0]])
    behind = 3e-2 * hidden.line_of_sight + np.array([[0.0, 0.0, 0.0], [2e-3, 1e-3, 0.0]])
    np.testing.assert_allclose(visible(places, behind), 1.0)


def test_channels_of_an_exposure_have_one_time(still):
    """A camera with polarisation channels records frames 2 k and 2 k + 1 at once."""
    path = Trajectory(1e-6 * still.hidden_object.axes.down)
    told = motion_of(moving(replace(still, camera=replace(still.camera, polarisation_channels=2)), path), 4)
    assert [one["time_s"] for one in told] == [5e-5, 5e-5, INTERVAL_S + 5e-5, INTERVAL_S + 5e-5]
