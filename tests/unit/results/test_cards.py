"""Cards as text: tables that fit, numbers that are never cut."""

from radioloc.results.cards import Card, Field, text_table

ROWS = (("KASHI", "1.0", "0 +- 10"), ("a name that is much too long for its column", "-22222.0", "free"))


def test_numbers_are_never_cut():
    lines = text_table(("station", *(f"column {k}" for k in range(9))), (("KASHI", *["-123456.78"] * 9),), 40)
    assert lines[1].split() == ["KASHI", *["-123456.78"] * 9]


def test_rows_of_the_rest_are_counted_by_name():
    rest = (("zenith_delay", "6 h", "1"), ("zenith_delay", "12 h", "1"), ("clock", "6 h", "1"))
    field = Field("estimated", (), ("parameter", "arc", "sigma"), ROWS[:1], ("below",), rest, "arcs.json")
    text = str(Card((field,)))
    assert "KASHI" in text
    assert "zenith_delay" not in text
    assert text.index("2 more in arcs.json") < text.index("below")
    page = Card((field,)).html()
    assert page.index("<summary>2 more</summary>") < page.index("zenith_delay") < page.index("below")


def test_markup_is_text():
    card = Card((Field("notes", ("[bold]not bold[/bold] :moon:",), ("[red]a", "b"), (("[/red]", "1"),)),))
    assert "[bold]not bold[/bold] :moon:" in str(card)
    assert "[red]a" in str(card)
    assert "[/red]" in str(card)
    assert "\x1b" not in str(card)
