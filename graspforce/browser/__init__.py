"""Views in a web browser: running simulations and streams, recordings and plans. They need the extra `view`."""

from graspforce.browser.browser_scene import BrowserScene, ViewAddress
from graspforce.browser.live_view import LiveView
from graspforce.browser.playback import Playback
from graspforce.browser.readings import Readings
from graspforce.browser.stream_view import StreamView

__all__ = ["BrowserScene", "LiveView", "Playback", "Readings", "StreamView", "ViewAddress"]
