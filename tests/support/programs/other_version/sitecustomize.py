"""Makes this whole process one of another zarm version; Python imports this file first if its folder is on the path."""

import os

import zarm_contract.codec

zarm_contract.codec.CONTRACT = os.environ.get("ZARM_TEST_CONTRACT", zarm_contract.codec.CONTRACT)

import zarm_runtime.version  # noqa: E402 - after the contract

zarm_runtime.version.version = lambda: os.environ["ZARM_TEST_VERSION"]
