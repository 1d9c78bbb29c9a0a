"""What is stored is what is read, and every bad file is one sentence."""

import numpy as np
import pytest
import tifffile
from PIL import Image

from posterior.images import fit_to, read_picture, to_grey, to_unit_range, write_tiff

GREY = np.arange(48 * 40, dtype=np.uint8).reshape(48, 40)
DEEP = GREY.astype(np.uint16) * 257
COLOUR = np.stack([GREY, GREY // 2, GREY // 4], axis=-1)
PAGES = np.stack([DEEP, DEEP // 2, DEEP // 3])
COMPLEX = GREY / 255 * np.exp(1j * GREY / 255)


def _write(folder, name, array):
    path = folder / name
    if path.suffix in (".png", ".jpg"):
        Image.fromarray(array).save(path)
    elif path.suffix == ".tif":
        kind = "rgb" if "colour" in name else "minisblack"
        packing = "zlib" if "packed" in name else None
        tifffile.imwrite(path, array, photometric=kind, compression=packing)
    elif path.suffix == ".npz":
        np.savez(path, picture=array)
    else:
        np.save(path, array)
    return path


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("grey.png", GREY),
        ("deep.png", DEEP),
        ("bits.png", GREY > 100),
        ("colour.png", COLOUR),
        ("deep.tif", DEEP),
        ("float.tif", (GREY / 255).astype("f4")),
        ("pages.tif", PAGES),
        ("packed.tif", PAGES),
        ("colour.tif", COLOUR),
        ("complex.npy", COMPLEX),
        ("pages.npy", PAGES),
        ("one.npz", COMPLEX),
    ],
)
def test_what_is_stored_is_read(tmp_path, name, array):
    found = read_picture(_write(tmp_path, name, array))
    assert found.dtype == array.dtype
    np.testing.assert_array_equal(found, array)


def test_a_jpeg_is_read(tmp_path):
    smooth = np.add.outer(np.arange(32), np.arange(32)).astype(np.uint8)
    found = read_picture(_write(tmp_path, "a.jpg", smooth))
    assert found.dtype == np.uint8
    assert np.abs(found.astype(int) - smooth).max() < 8


def test_the_content_counts_not_the_name(tmp_path):
    path = _write(tmp_path, "deep.tif", DEEP)
    np.testing.assert_array_equal(read_picture(path.rename(tmp_path / "deep.png")), DEEP)


def test_pages_of_equal_shape_are_one_stack(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", DEEP)
    tifffile.imwrite(tmp_path / "a.tif", DEEP, append=True)
    assert read_picture(tmp_path / "a.tif").shape == (2, *DEEP.shape)


def test_a_page_is_picked(tmp_path):
    path = _write(tmp_path, "pages.tif", PAGES)
    np.testing.assert_array_equal(read_picture(path, page=2), PAGES[2])
    colour = _write(tmp_path, "colour.png", COLOUR)
    np.testing.assert_array_equal(read_picture(colour, page=0), COLOUR)


def test_an_array_of_a_file_of_many_is_named(tmp_path):
    np.savez(tmp_path / "two.npz", a=GREY, b=DEEP)
    np.testing.assert_array_equal(read_picture(f"{tmp_path}/two.npz:b"), DEEP)


def _bad_files(folder):
    (folder / "text.png").write_text("no picture")
    (folder / "empty.tif").touch()
    np.save(folder / "nan.npy", np.where(GREY > 5, np.nan, 1.0))
    np.save(folder / "words.npy", np.array([["a", "b"]]))
    np.save(folder / "line.npy", np.ones(5))
    np.savez(folder / "two.npz", a=GREY, b=DEEP)
    with tifffile.TiffWriter(folder / "mixed.tif") as tiff:
        tiff.write(GREY)
        tiff.write(GREY[:20])
    _write(folder, "pages.tif", PAGES)


@pytest.mark.parametrize(
    ("name", "page", "sentence"),
    [
        ("nowhere.png", None, "no file .*: give the path of a picture"),
        (".", None, "is a folder: give one picture file"),
        ("text.png", None, "is no picture: give a PNG, JPEG, TIFF, NPY or NPZ file"),
        ("empty.tif", None, "is empty"),
        ("nan.npy", None, r"holds NaN or infinity in \d+ places"),
        ("words.npy", None, "not numbers: save a numeric array"),
        ("line.npy", None, r"shape \(5,\): a picture is \(height, width\)"),
        ("two.npz", None, "holds the arrays a, b: name one, as in .*two.npz:a"),
        ("two.npz:c", None, "has no array 'c': it holds a, b"),
        ("mixed.tif", None, "pictures of shapes .*: save the one you mean alone"),
        ("pages.tif", 3, "page 3 of pages.tif: it has 3 pages, the last is 2"),
        ("pages.tif", -1, "page -1: pages are counted from 0"),
    ],
)
def test_bad_files_are_one_sentence(tmp_path, name, page, sentence):
    _bad_files(tmp_path)
    with pytest.raises((ValueError, FileNotFoundError), match=sentence) as caught:
        read_picture(f"{tmp_path}/{name}", page)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.tif", "packed.tif", "a.npy", "a.npz"])
@pytest.mark.parametrize("kept", [0.3, 0.7, 0.95])
def test_truncated_files_are_refused(tmp_path, caplog, name, kept):
    noise = np.random.default_rng(0).integers(0, 255, (48, 40), dtype=np.uint8)
    path = _write(tmp_path, name, noise)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(kept * len(whole))])
    with pytest.raises(ValueError, match="damaged or truncated"):
        read_picture(path)
    assert not caplog.records


def test_unit_range_of_every_dtype():
    for full in (np.uint8(255), np.uint16(65535), np.float32(1), np.bool_(True)):
        picture = np.array([[0, full]], dtype=full.dtype)
        np.testing.assert_array_equal(to_unit_range(picture), [[0.0, 1.0]])


@pytest.mark.parametrize(
    ("picture", "sentence"),
    [
        (np.array([[0.0, 255.0]]), "the value 255, outside 0..1: divide it by its full scale"),
        (np.array([[-0.25, 1.0]]), "the value -0.25, outside 0..1"),
        (np.array([[0, 1]], dtype=np.int32), "int32 has no known full scale"),
        (np.array([[1j]]), "complex128 has no known full scale"),
    ],
)
def test_unit_range_refuses(picture, sentence):
    with pytest.raises(ValueError, match=sentence):
        to_unit_range(picture)


def test_grey_of_every_shape():
    grey = np.linspace(0, 1, 12).reshape(3, 4)
    for channels in (1, 3):
        found = to_grey(np.stack([grey] * channels, axis=-1))
        np.testing.assert_allclose(found, grey, atol=1e-12)
    for channels in (2, 4):
        with_alpha = np.stack([*[grey] * (channels - 1), np.ones_like(grey)], axis=-1)
        np.testing.assert_allclose(to_grey(with_alpha), grey, atol=1e-12)
    with pytest.raises(ValueError, match="holds 7 pages: choose one with --page"):
        to_grey(np.zeros((7, 20, 20)))


def test_fit_takes_the_central_square():
    picture = np.zeros((20, 30))
    picture[:, 5:25] = 1
    np.testing.assert_array_equal(fit_to(picture, 20), np.ones((20, 20)))
    np.testing.assert_allclose(fit_to(picture, 10), 1)


def test_fit_does_not_alias_and_takes_complex():
    stripes = np.tile([0.0, 1.0], (32, 16))
    found = fit_to(stripes + 2j * stripes, 8)
    # Stripes finer than the new pixels must become grey, not coarser stripes.
    np.testing.assert_allclose(found[2:-2, 2:-2], 0.5 + 1j, atol=0.03)


def test_fit_never_enlarges():
    with pytest.raises(ValueError, match="size 31 is above .* shorter side: give 20 or less"):
        fit_to(np.zeros((20, 30)), 31)


def test_tiff_round_trip(tmp_path):
    path = tmp_path / "a.tif"
    write_tiff(path, GREY / 255)
    found = read_picture(path)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, (GREY / 255).astype("f4"))
    assert [p.name for p in tmp_path.iterdir()] == ["a.tif"]


def test_a_tiff_in_colour_is_read_as_one(tmp_path):
    write_tiff(tmp_path / "a.tif", COLOUR / 255, colour=True)
    np.testing.assert_array_equal(read_picture(tmp_path / "a.tif"), (COLOUR / 255).astype("f4"))


def test_tiff_refuses_complex_and_keeps_the_old_file(tmp_path):
    path = tmp_path / "a.tif"
    write_tiff(path, GREY / 255)
    before = path.read_bytes()
    with pytest.raises(ValueError, match="write amplitude and phase apart"):
        write_tiff(path, COMPLEX)
    assert path.read_bytes() == before
