from .layout_tables import PAGE, filled, tables


def test_the_page_on_the_log_is_in_step_with_its_layout() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert filled(page) == page
    assert all(text in page for text in tables().values())
