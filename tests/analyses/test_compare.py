"""Sentences of a comparison."""

from calib.analyses.compare import comparison_at
from calib.study import Study


def test_modes_paired_by_the_user_are_reported(here, mast, edited):
    def said(folder):
        study = Study.load(folder)
        return [s for s in comparison_at(study, study.search_space.values).sentences if "Paired as the study says" in s]

    folder = mast.write_study(here / "mast")
    assert not said(folder)
    chosen = edited(folder, "[pairing]\n", "[pairing]\noverride = { B2x = 4 }\n")
    assert said(chosen) == ["Paired as the study says and not as computed: B2x with model mode 4."]
