"""Files of prompts: what they say, and where they are wrong."""

import pytest

from motionkit.core.errors import UsageError
from motionkit.generate.models import GenerationRequest
from motionkit.generate.request import read_prompts


def test_one_text_a_line(tmp_path):
    path = tmp_path / "prompts.txt"
    path.write_text("a person walks, slowly\n\n  a jump \n")
    prompts = read_prompts(path, 4.0)
    assert [prompt.request.text for prompt in prompts] == ["a person walks, slowly", "a jump"]
    assert {prompt.request.duration_seconds for prompt in prompts} == {4.0}
    assert prompts[1].where == f"{path}, line 3"


def test_a_table_of_texts_and_actions(tmp_path):
    (tmp_path / "p.csv").write_text('﻿text,seconds,action\n"up, then down",2.5,\n,,jump\n', encoding="utf-8")
    found = [prompt.request for prompt in read_prompts(tmp_path / "p.csv")]
    assert found == [GenerationRequest(2.5, text="up, then down"), GenerationRequest(None, action="jump")]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("p.xlsx", "a walk", r"prompts are a \.txt"),
        ("p.txt", " \n", "holds no prompts"),
        ("p.txt", "a walk\n\xff\xfe\n", "not UTF-8"),
        ("p.csv", "words\na walk\n", "line 2: unknown column 'words'"),
        ("p.csv", "seconds\n2\n", "line 2: give a text or an action, there is neither"),
        ("p.csv", "text,seconds\na walk, slowly,2\n", "line 2: more fields than the header names"),
        ("p.csv", "text,action\na walk,walk\n", "line 2: give a text or an action, not both"),
        ("p.csv", "text,seconds\na walk,-1\n", "line 2: seconds is a positive number, not '-1'"),
        ("p.csv", "text,seconds\na walk,soon\n", "line 2: seconds is a number, not 'soon'"),
        ("p.csv", 'text\n"a walk\n', "not a CSV table"),
    ],
)
def test_faults_are_named_with_their_line(tmp_path, name, text, message):
    (tmp_path / name).write_bytes(text.encode("latin-1"))
    with pytest.raises(UsageError, match=message):
        read_prompts(tmp_path / name)
