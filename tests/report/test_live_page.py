"""The live view in a browser: what a stream says is on the page."""

import numpy as np
from playwright.sync_api import Browser

from phytac_decoder.pipeline.frame_reading import Reading
from phytac_decoder.serving.live_view import LiveView
from phytac_decoder.serving.wire_protocol import MessageBuilder
from tests.decoder.test_reading import located, reading
from tests.decoder.toy_sensor import toy_bundle
from tests.report.conftest import WAIT_MS, Tab


def test_contacts_of_every_kind_are_shown(browser: Browser) -> None:
    """Also one that was found by motion alone, and those of estimators that know no spread."""
    make = MessageBuilder(bundle=toy_bundle(), estimator="auto")
    silent = located(2.5, (41.0, 39.0, 0.0))
    both = reading(located(4.0, (10.5, 10.0, 0.0), 7), silent)
    forces = np.zeros(30)
    forces[7] = 3.0
    grouped = Reading(koi=np.array([7]), forces_N=forces)
    context = browser.new_context()
    try:
        with LiveView(make.hello(), port=0) as view:
            tab = Tab(context.new_page())
            tab.page.goto(f"http://127.0.0.1:{view.port}/", timeout=WAIT_MS)
            tab.page.get_by_text("toy, auto").wait_for(timeout=WAIT_MS)
            shown, net = [], []
            for number, (each, total) in enumerate([(both, "6.5 N"), (grouped, "3.0 N")]):
                view.publish(make.frame(each, sequence=number, timestamp_s=0.1 * number))
                tab.page.get_by_text(total, exact=True).wait_for(timeout=WAIT_MS)
                # The drawing is done in the same step as the table, after it.
                tab.page.wait_for_timeout(50)
                shown.append(tab.page.locator("#contacts tr").all_inner_texts())
                net.append(tab.page.locator("#net tr").all_inner_texts())
            assert tab.page.get_by_text("moment about (0, 0, 0) mm").count() == 1
    finally:
        context.close()
    # Browsers ask for an icon; there is none.
    assert [text for text in tab.errors if "404" not in text] == []
    first, second = ([row.split("\t") for row in table] for table in shown)
    assert first[0] == ["id", "N", "±", "mm wide", "since s"]
    assert [row[:3] for row in first[1:]] == [["0", "4.00", "0.20"], ["1", "2.50", "0.13"]]
    assert second[0] == ["id", "N", "mm wide", "since s"]
    assert second[1][:2] == ["0", "3.00"]
    # 4 N at (10.5, 10) and 2.5 N at (41, 39) mm, inward; then 3 N at (10, 10) mm.
    both_rows = [["N", "0.00", "0.00", "-6.50"], ["N·mm", "-137.5", "144.5", "0.0"]]
    assert [row.split("\t") for row in net[0][1:]] == both_rows
    assert net[1][2].split("\t") == ["N·mm", "-30.0", "30.0", "0.0"]
