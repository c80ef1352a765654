"""What a run says of its pictures, in no more lines than there are things to say."""

from uwaug.jobs.remarks import Remarks


def test_equal_texts_are_told_once() -> None:
    remarks = Remarks(3)
    for number in (1, 2):
        names = [f"{number}.png", f"{number}.npy", f"{number}.png with {number}.npy"]
        for text in ("is faint", f"{number}.npy: is empty", f"{names[2]}: distance is NaN"):
            remarks.add(text, names)
    assert list(remarks) == [
        "2 × is faint (first: 1.png)",
        "2 × is empty (first: 1.npy)",
        "2 × distance is NaN (first: 1.png with 1.npy)",
    ]
    remarks.add("is another", ["3.png"])
    remarks.add("is faint", ["3.png"])
    assert (remarks.dropped, next(iter(remarks))) == (1, "3 × is faint (first: 1.png)")


def test_numbers_alone_make_no_other_text() -> None:
    remarks = Remarks(3, reword=str.upper)
    for number in (1, 22.5):
        remarks.add(f"hole of {number} px", [f"{number}.png"])
    remarks.add("is faint", ["3.png"])
    assert list(remarks) == ["2 × HOLE OF 1 PX (first: 1.png)", "3.png: IS FAINT"]


def test_a_single_text_names_its_file() -> None:
    remarks = Remarks(9)
    remarks.add("is faint", ["1.png"])
    remarks.add("is 3 px but 1.png is 4", ["1.png"])
    remarks.add("z.npy: is empty", ["1.png", "z.npy"])
    assert list(remarks) == ["1.png: is faint", "is 3 px but 1.png is 4", "z.npy: is empty"]
