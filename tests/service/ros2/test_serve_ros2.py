"""`graspforce serve --ros2`: the settings of the node, and a process that appears at the router until its end."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest
from support.box_grasp import make_grasp
from support.ros2_peer import HOST, peer, router
from support.servers import ANY_LOCAL_PORT, TIMEOUT, wait_until
from zenoh_ros2_sdk.discovery import get_topic_names_and_types

from graspforce.cli import main
from graspforce.core.errors import InvalidInput, UnknownName
from graspforce.service.ros2.node_settings import SETTING_NAMES, read_settings


def test_settings_reach_the_options(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "5")
    texts = ["name=hand", "namespace=/left", "rate=250", "commands=/effort_controller/commands", "slip_margin=0.8"]
    node, hold = read_settings(texts)
    assert (node.name.name, node.name.namespace, node.name.domain) == ("hand", "/left", 5)
    assert (node.commands, hold.rate, hold.settings.slip_margin) == ("/effort_controller/commands", 250.0, 0.8)
    assert read_settings(["domain=7"])[0].name.domain == 7
    for text, error in (("rates=5", UnknownName), ("rate=fast", InvalidInput), ("domain=1.5", InvalidInput)):
        with pytest.raises(error):
            read_settings([text])
    assert len(set(SETTING_NAMES)) == len(SETTING_NAMES)


def test_a_served_grasp_appears_at_the_router_and_leaves_it(tmp_path):
    file = tmp_path / "grasp.json"
    make_grasp().save(file)
    with router() as address, peer(address) as joined:
        command = [sys.executable, "-m", "graspforce", "serve", "--hand", "four_finger", "--listen", ANY_LOCAL_PORT]
        command += ["--ros2", address, "--grasp", str(file), "--ros2-setting", "namespace=/right", "--ros2-setting", "domain=0"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            assert address in process.stdout.readline()
            topics = dict(get_topic_names_and_types(0, HOST, joined.port))
            assert "/right/graspforce/commands" in topics
            process.send_signal(signal.SIGINT)
            assert process.wait(TIMEOUT) == 0
        wait_until(lambda: not get_topic_names_and_types(0, HOST, joined.port))


def test_a_node_needs_a_grasp_and_one_hand(capsys, tmp_path):
    assert main(["serve", "--hand", "four_finger", "--ros2", "tcp/127.0.0.1:7447"]) != 0
    assert "--grasp" in capsys.readouterr().err
    file = tmp_path / "grasp.json"
    make_grasp().save(file)
    assert main(["serve", "--ros2", "tcp/127.0.0.1:7447", "--grasp", str(file)]) != 0
    assert "--hand" in capsys.readouterr().err
