"""Drives the page of `retroflex page` in a headless Chromium, over the pipe of its DevTools protocol.

browser.py CHROMIUM SOCKET PICTURES ADDRESS PID GUARDED_ADDRESS TOKEN

SOCKET is the command socket of a service at rest, ADDRESS the page without a token and PID its process, which is killed in the end.
GUARDED_ADDRESS is a page with TOKEN. It exits with a message at the first statement that does not hold. Standard library only.
"""

import base64
import json
import math
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time

CHROMIUM, SOCKET, PICTURES, ADDRESS, PID, GUARDED, TOKEN = sys.argv[1:]
PID = int(PID)


class Service:
    """A client of the service beside the page."""

    def __init__(self, path):
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.settimeout(10)
        self.socket.connect(path)
        self.file = self.socket.makefile("rw")

    def ask(self, cmd, **more):
        began = time.monotonic()
        while True:
            self.file.write(json.dumps({"v": 1, "id": 1, "cmd": cmd, **more}) + "\n")
            self.file.flush()
            reply = json.loads(self.file.readline())
            if reply["ok"]:
                return reply["result"]
            # a tip that brakes refuses a motion
            assert time.monotonic() - began < 2, reply
            time.sleep(0.05)

    def status(self):
        return self.ask("status")


class Browser:
    """One tab of a headless Chromium."""

    def __init__(self, profile):
        to_browser, from_here = os.pipe()
        from_browser, to_here = os.pipe()
        command = [CHROMIUM, "--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-dev-shm-usage",
                   "--hide-scrollbars", f"--user-data-dir={profile}", "--remote-debugging-pipe", "about:blank"]
        # the browser reads descriptor 3 and writes 4
        shell = ["sh", "-c", f'exec "$@" 3<&{to_browser} 4>&{to_here}', "sh", *command]
        log = open(os.path.join(PICTURES, "chromium.log"), "w")
        self.process = subprocess.Popen(shell, pass_fds=(to_browser, to_here), stdout=log, stderr=log)
        os.close(to_browser)
        os.close(to_here)
        self.to, self.source = from_here, os.fdopen(from_browser, "rb")
        self.number, self.session, self.buffer = 0, None, b""
        self.events = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ["Page", "Network", "Runtime"]:
            self.call(f"{domain}.enable")

    def call(self, method, **params):
        self.number += 1
        message = {"id": self.number, "method": method, "params": params}
        if self.session:
            message["sessionId"] = self.session
        os.write(self.to, json.dumps(message).encode() + b"\0")
        while True:
            while b"\0" not in self.buffer:
                part = os.read(self.source.fileno(), 1 << 20)
                assert part, "the browser ended; see chromium.log"
                self.buffer += part
            line, self.buffer = self.buffer.split(b"\0", 1)
            answer = json.loads(line)
            if answer.get("id") == self.number:
                assert "error" not in answer, (method, answer["error"])
                return answer["result"]
            if "method" in answer:
                self.events.append(answer)

    def js(self, code):
        result = self.call("Runtime.evaluate", expression=code, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in result, (code, result["exceptionDetails"])
        return result["result"].get("value")

    def until(self, what, code, seconds=10.0):
        """Waits until an expression holds; returns the time it took."""
        began = time.monotonic()
        while not self.js(code):
            words = self.js("document.body.innerText")
            assert time.monotonic() - began < seconds, f"{what}: not within {seconds} s; the page shows:\n{words}"
            time.sleep(0.02)
        return time.monotonic() - began

    def open(self, url):
        self.events.clear()
        self.call("Page.navigate", url=url)
        self.until("the page", "document.readyState === 'complete'")

    def size(self, width, height, ratio=1):
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=ratio, mobile=False)

    def dark(self, on):
        features = [{"name": "prefers-color-scheme", "value": "dark" if on else "light"}]
        self.call("Emulation.setEmulatedMedia", features=features)

    def picture(self, name):
        time.sleep(0.2)
        data = self.call("Page.captureScreenshot", format="png")["data"]
        with open(os.path.join(PICTURES, f"{name}.png"), "wb") as file:
            file.write(base64.b64decode(data))

    def mouse(self, kind, x, y):
        self.call("Input.dispatchMouseEvent", type=f"mouse{kind}", x=x, y=y, button="left", clickCount=1,
                  buttons=0 if kind == "Released" else 1)

    def box(self, selector):
        return self.js(f"(({{x, y, width, height}}) => [x, y, width, height])(document.querySelector({json.dumps(selector)}).getBoundingClientRect())")

    def click(self, selector):
        x, y, w, h = self.box(selector)
        self.mouse("Pressed", x + w / 2, y + h / 2)
        self.mouse("Released", x + w / 2, y + h / 2)

    def key(self, key, code=None, text=None, shift=False):
        common = {"key": key, "code": code or key, "modifiers": 8 if shift else 0,
                  "windowsVirtualKeyCode": {"Enter": 13, " ": 32, "Escape": 27, "Tab": 9, "ArrowUp": 38, "ArrowRight": 39}[key]}
        self.call("Input.dispatchKeyEvent", type="keyDown", **common, **({"text": text} if text else {}))
        self.call("Input.dispatchKeyEvent", type="keyUp", **common)

    def pad(self, bend, direction):
        """Place of a bend on the pad."""
        at = self.js("(() => { const p = padScale(); return [p.box.left + p.cx, p.box.top + p.cy, p.k]; })()")
        angle = math.radians(direction)
        return at[0] + bend * math.cos(angle) * at[2], at[1] - bend * math.sin(angle) * at[2]

    def drag(self, *bends):
        """Presses at the first bend and moves to the others."""
        self.mouse("Pressed", *self.pad(*bends[0]))
        for bend in bends[1:]:
            self.mouse("Moved", *self.pad(*bend))
            time.sleep(0.12)


def wait(service, what, holds, seconds=10.0):
    began = time.monotonic()
    while not holds(status := service.status()):
        assert time.monotonic() - began < seconds, f"{what}: not within {seconds} s: {json.dumps(status)[:600]}"
        time.sleep(0.03)
    return status


def near(pose, bend, direction, within=1.5):
    if not pose:
        return False
    a, b = math.radians(pose["dir_deg"]), math.radians(direction)
    x, y = pose["bend_deg"] * math.cos(a) - bend * math.cos(b), pose["bend_deg"] * math.sin(a) - bend * math.sin(b)
    return math.hypot(x, y) < within


def done(text):
    print(f"ok: {text}", flush=True)


SHOWN = "Number.parseFloat(document.getElementById('figures').textContent)"
LIVE = "document.getElementById('lost').hidden"


def loads_and_follows(b, service):
    b.size(1024, 768)
    b.dark(False)
    b.open(f"http://{ADDRESS}/")
    b.until("a live picture", f"{LIVE} && document.getElementById('mode').textContent === 'disarmed'")
    urls = [e["params"]["request"]["url"] for e in b.events if e["method"] == "Network.requestWillBeSent"]
    foreign = [url for url in urls if not url.startswith(f"http://{ADDRESS}/") and not url.startswith("data:")]
    assert len(urls) >= 4 and not foreign, urls
    assert "leak of line 2" in b.js("document.getElementById('diagnosis').textContent")
    b.picture("disarmed")
    b.click("[data-command=arm]")
    wait(service, "armed by the button", lambda s: s["mode"] == "holding")
    b.until("the mode", "document.getElementById('mode').textContent === 'holding'")
    service.ask("bend", bend_deg=55, dir_deg=30, speed_deg_s=40)
    b.until("the way", f"{SHOWN} > 15 && {SHOWN} < 50")
    b.picture("moving")
    b.until("the end of the move", f"Math.abs({SHOWN} - 55) < 1")
    pixels = "new Set(document.getElementById('tip').getContext('2d').getImageData(0, 0, 600, 300).data).size"
    assert b.js(pixels) > 50, "the tip is not drawn"
    b.picture("bent")
    done("loads, needs no other place, and follows a move")


def drag_bends(b, service):
    b.drag((20, 0), (25, 0), (30, 10), (35, 20))
    b.picture("dragging")
    b.mouse("Released", *b.pad(35, 20))
    wait(service, "the target of the drag", lambda s: near(s["target"], 35, 20))
    wait(service, "the bend", lambda s: near(s["estimate"], 35, 20))
    # beyond the reach it goes as far as it can
    b.drag((35, 20), (200, 90))
    b.mouse("Released", *b.pad(200, 90))
    status = wait(service, "the edge of the reach", lambda s: s["target"] and abs(s["target"]["dir_deg"] - 90) < 1)
    assert 60 < status["target"]["bend_deg"] < 110, status["target"]
    done("a drag commands a bend, and stays within the reach")


def a_stray_click_moves_nothing(b, service):
    service.ask("bend", bend_deg=10, dir_deg=0)
    wait(service, "the bend", lambda s: near(s["target"], 10, 0) and s["settled"])
    b.until("the target on the page", "frame.target && Math.abs(frame.target.bend_deg - 10) < 0.1")
    for bend, direction in [(70, 200), (45, 90), (25, 0), (60, 310)]:
        b.mouse("Pressed", *b.pad(bend, direction))
        b.mouse("Released", *b.pad(bend, direction))
        time.sleep(0.6)
        assert near(service.status()["target"], 10, 0, 0.1), ("a click moved the tip", bend, direction)
        assert b.js(f"Math.abs(Math.hypot(aim.x, aim.y) - {bend}) < 1 && aiming"), "the target of a click is not drawn"
    # held, it bends there, at a bounded rate
    b.mouse("Pressed", *b.pad(60, 0))
    began, at, fastest = time.monotonic(), None, 0.0
    while time.monotonic() - began < 1.2:
        status = service.status()
        now = (time.monotonic(), status["setpoint"]["bend_deg"])
        if at and now[0] - at[0] > 0.1:
            fastest, at = max(fastest, abs(now[1] - at[1]) / (now[0] - at[0])), now
        at = at or now
    b.mouse("Released", *b.pad(60, 0))
    wait(service, "the target of the press", lambda s: near(s["target"], 60, 0))
    assert 15 < fastest < 45, f"{fastest:.0f} degrees a second"
    wait(service, "the bend", lambda s: near(s["estimate"], 60, 0))
    done("a click draws a target and moves nothing; held, it bends at a bounded rate")


def keyboard_bends_and_stops(b, service):
    service.ask("bend", bend_deg=10, dir_deg=0)
    wait(service, "the bend", lambda s: near(s["target"], 10, 0) and s["settled"])
    b.until("the target on the page", "frame.target && Math.abs(frame.target.bend_deg - 10) < 0.1")
    b.js("document.activeElement.blur()")
    for _ in range(12):
        b.key("Tab")
        if b.js("document.activeElement.id") == "pad":
            break
    assert b.js("document.activeElement.id") == "pad", "the pad is not reached with Tab"
    for _ in range(5):
        b.key("ArrowUp")
    b.picture("keyboard")
    assert near(service.status()["target"], 10, 0, 0.1), "an arrow key alone moves nothing"
    b.key("Enter", text="\r")
    wait(service, "the bend of the keys", lambda s: near(s["target"], math.hypot(10, 10), 45, 0.3))
    wait(service, "the end of the move", lambda s: s["settled"])
    for name, press in [("button", lambda: b.click("#stop")), ("space bar", lambda: b.key(" ", "Space", " ")), ("Esc", lambda: b.key("Escape"))]:
        service.ask("bend", bend_deg=60, dir_deg=120, speed_deg_s=5)
        time.sleep(0.4)
        began = time.monotonic()
        press()
        wait(service, f"a stop by the {name}", lambda s: s["stopped"], 1.0)
        took = time.monotonic() - began
        b.until("the answer", "document.getElementById('said').textContent.startsWith('Stopped')")
        said = b.js("document.getElementById('said').textContent")
        b.until("the mode", "document.getElementById('mode').textContent === 'stopped'")
        b.until("a disabled relax", "document.querySelector('[data-command=relax]').disabled")
        print(f"   {name}: latched after {1e3 * took:.0f} ms; {said}", flush=True)
        if name == "button":
            b.picture("stopped")
        b.js("document.querySelector('[data-command=arm]').focus()")
        b.until("the button", "!document.querySelector('[data-command=arm]').disabled")
        b.key("Enter", text="\r")
        wait(service, "armed with the keyboard", lambda s: not s["stopped"] and s["mode"] == "holding")
    done("the keyboard bends; button, space bar and Esc stop")


def zoom_and_dark(b):
    b.dark(True)
    b.picture("dark")
    # a zoom of 200 % halves the window
    b.size(512, 384, 2)
    time.sleep(0.3)
    for scroll in ["0", "document.documentElement.scrollHeight"]:
        b.js(f"scrollTo(0, {scroll})")
        time.sleep(0.1)
        x, y, w, h = b.box("#stop")
        assert x >= 0 and y >= 0 and x + w <= 512 and y + h <= 384 and h >= 40, ("the stop button is not in view", x, y, w, h)
        middle = b.js(f"document.elementFromPoint({x + w / 2}, {y + h / 2}).closest('button')?.id")
        assert middle == "stop", f"{middle} covers the stop button"
    assert b.js("document.documentElement.scrollWidth <= innerWidth"), "the page is wider than the window"
    assert b.js("document.querySelector('footer').getBoundingClientRect().height < 0.5 * innerHeight"), "the footer hides the page"
    b.js("scrollTo(0, 0)")
    b.picture("zoomed")
    b.dark(False)
    b.size(1024, 768)
    b.until("a live picture", LIVE)
    done("200 % zoom keeps stop in view; dark")


def lost_connection(b, service):
    # a server that hangs, in the middle of a drag
    service.ask("bend", bend_deg=20, dir_deg=0)
    wait(service, "the bend", lambda s: s["settled"] and near(s["target"], 20, 0))
    b.drag((20, 0), (22, 0))
    wait(service, "the drag", lambda s: near(s["target"], 22, 0, 0.5))
    os.kill(PID, signal.SIGSTOP)
    took = b.until("the loss of a server that hangs", f"!{LIVE}", 1.5)
    assert took < 1.0, f"a server that hangs is noticed after {took:.2f} s"
    b.mouse("Moved", *b.pad(60, 90))
    b.js("document.getElementById('pad').focus()")
    b.key("ArrowUp")
    b.key("Enter", text="\r")
    assert b.js("document.getElementById('mode').textContent") == "not connected"
    assert b.js("[...document.querySelectorAll('[data-command]')].every((button) => button.disabled)"), "a command is enabled"
    assert not b.js("document.getElementById('stop').disabled"), "stop is disabled"
    b.picture("lost")
    os.kill(PID, signal.SIGCONT)
    b.until("a live picture again", LIVE)
    # the press that was interrupted does not go on
    b.mouse("Moved", *b.pad(50, 90))
    b.mouse("Released", *b.pad(50, 90))
    time.sleep(1.0)
    assert near(service.status()["target"], 22, 0, 0.5), f"a command was sent late: {service.status()['target']}"
    # a server that is killed
    os.kill(PID, signal.SIGKILL)
    gone = b.until("the loss of a server that is killed", f"!{LIVE}", 1.5)
    assert gone < 1.0, f"a killed server is noticed after {gone:.2f} s"
    b.drag((22, 0), (50, 90))
    b.mouse("Released", *b.pad(50, 90))
    b.click("#stop")
    b.until("the failure of a stop in words", "document.getElementById('said').textContent.includes('NO ANSWER')")
    b.picture("killed")
    time.sleep(0.5)
    status = service.status()
    assert near(status["target"], 22, 0, 0.5) and not status["stopped"], status["target"]
    done(f"a hung server is shown after {took:.2f} s, a killed one after {gone:.2f} s, and nothing is sent")


def token(b):
    for query in ["", "?token=" + "0" * len(TOKEN)]:
        b.open(f"http://{GUARDED}/{query}")
        responses = [e["params"]["response"] for e in b.events if e["method"] == "Network.responseReceived"]
        codes = [r["status"] for r in responses if GUARDED in r["url"]]
        assert 401 in codes and 200 not in codes, codes
        assert "retroflex" not in b.js("document.documentElement.outerHTML.replace(location.href, '')").replace(GUARDED, ""), "a wrong token shows the page"
    b.open(f"http://{GUARDED}/?token={TOKEN}")
    b.until("a live picture with the token", f"typeof live === 'function' && {LIVE}")
    assert b.js("location.search") == "", "the token stays in the address"
    b.open(f"http://{GUARDED}/")
    b.until("a live picture with the cookie", f"typeof live === 'function' && {LIVE}")
    done("a wrong token gets nothing")


def main():
    service = Service(SOCKET)
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        b = Browser(profile)
        try:
            loads_and_follows(b, service)
            drag_bends(b, service)
            a_stray_click_moves_nothing(b, service)
            keyboard_bends_and_stops(b, service)
            zoom_and_dark(b)
            token(b)
            b.open(f"http://{ADDRESS}/")
            b.until("a live picture", f"typeof live === 'function' && {LIVE}")
            lost_connection(b, service)
        except AssertionError:
            b.picture("failed")
            raise
        finally:
            b.process.kill()
            b.process.wait()


try:
    main()
except AssertionError as failure:
    sys.exit(f"FAILED: {failure}")
