"""Where answers are: every folder of them, and no study that a run has written among them."""

from calib.questions.extend import extend_among
from calib.questions.places import answers_of
from calib.results import Results
from calib.study import Study


def test_only_answers_count_as_answers(mast, tmp_path):
    study, home = Study.load(mast.write_study(tmp_path / "mast")), tmp_path / "results/mast"
    assert answers_of(study, tmp_path / "results") == ()
    for part in ("quick", "case_A1", "empty", ".hidden"):
        if part in ("quick", "case_A1"):
            Results.at(tmp_path / "results", "mast", part).write_json("answer", {})
        (home / part).mkdir(exist_ok=True)
        if part != "empty":
            (home / part / "parameters.csv").write_text("case,parameter\n")
    written = extend_among(study, ["guy"], home).file.parent
    assert any(written.glob("*.csv"))  # what was measured
    assert answers_of(study, tmp_path / "results") == (Results(home / "case_A1"), Results(home / "quick"))
    (home / "comparison_before.csv").write_text("mode\n")
    assert answers_of(study, tmp_path / "results")[0] == Results(home)
