"""What is said of a comparison beside its numbers."""

from calib.questions.compare import answer_at
from calib.study import Study


def test_modes_paired_by_choice_are_told(here, mast, edited):
    def told(folder):
        study = Study.load(folder)
        return [s for s in answer_at(study, study.search_space.values).sentences if "Paired as the study says" in s]

    folder = mast.write_study(here / "mast")
    assert not told(folder)
    chosen = edited(folder, "[pairing]\n", "[pairing]\noverride = { B2x = 4 }\n")
    assert told(chosen) == ["Paired as the study says and not as computed: B2x with model mode 4."]
