"""Views in a web browser: a running simulation with controls, and recordings with a timeline. They need the extra `view`."""

from graspforce.browser.browser_scene import BrowserScene, ViewAddress
from graspforce.browser.live_view import LiveView
from graspforce.browser.playback import Playback
from graspforce.browser.readings import Readings

__all__ = ["BrowserScene", "LiveView", "Playback", "Readings", "ViewAddress"]
